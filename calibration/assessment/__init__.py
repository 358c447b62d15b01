"""Assessment of a solved calibration.

The solution and its views go in. Findings, a diagnosis of inconsistent views, a report on each view and the reported
accuracy come out. Every finding has a code, a message, and a flag for blocking the use of the calibration.
"""

from calibration.assessment.acceptance import acceptance_findings
from calibration.assessment.diagnosis import diagnose
from calibration.assessment.evidence import Evidence, collect_evidence

__all__ = ["Evidence", "acceptance_findings", "collect_evidence", "diagnose"]
