"""States of jobs and of their views, and the form of ids, which API, jobs and storage share."""

from typing import Literal

ID_PATTERN = r"^[0-9a-z-]{1,64}$"
"""Form of the ids that the service makes. A later id sorts after an earlier one."""

ScanState = Literal[
    "queued", "connecting", "preflight", "scanning", "processing", "stopping",
    "succeeded", "partial", "failed", "aborted", "interrupted",
]  # fmt: skip
"""State of a scan, a calibration or a verification."""
ACTIVE_STATES: tuple[ScanState, ...] = ("queued", "connecting", "preflight", "scanning", "processing", "stopping")
"""States of a job that has not ended. All others are final."""
RESULT_STATES: tuple[ScanState, ...] = ("succeeded", "partial")
"""Final states of a scan that has a result."""
ViewState = Literal["moving", "recorded", "missing"]
