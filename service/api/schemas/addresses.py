"""Paths of the resources below `/api`."""

from service.errors import JobReference

SCANS = "/api/scans"
RECORDINGS = "/api/recordings"
RUNS = "/api/calibration/runs"


def job_address(job: JobReference) -> str:
    """Return the path of a scan, a calibration or a verification."""
    return f"{SCANS if job.kind == 'scan' else RUNS}/{job.id}"
