"""The report of `pointchain doctor`: a JSON document for programs, text for people."""

from dataclasses import asdict
from pathlib import Path

from cell.self_test.check_result import CheckResult
from service.cli.commands.check import format_step
from service.integrity.check import CheckReport
from service.integrity.database_check import MAX_REPORTED
from service.integrity.finding import GROUPS, Finding


def report_document(root: Path, found: CheckReport, repaired: list[str]) -> dict[str, object]:
    """Return the JSON document.

    Args:
        root: Data folder.
        found: What the check found, after a repair if there was one.
        repaired: Messages of the repair.
    """
    findings = [{name: value for name, value in asdict(one).items() if name != "key"} for one in found.findings]
    return {
        "healthy": not findings,
        "data_dir": str(root),
        "service_runs": found.service_runs,
        "findings": findings,
        "repaired": repaired,
    }


def format_report(found: CheckReport) -> str:
    """Return the lines of text: the findings of each group, at most `MAX_REPORTED`, and a summary."""
    lines = []
    for group in GROUPS:
        of_group = [finding for finding in found.findings if finding.group == group]
        if of_group:
            lines += [format_step(_step(finding)) for finding in of_group[:MAX_REPORTED]]
            if len(of_group) > MAX_REPORTED:
                more = f"and {len(of_group) - MAX_REPORTED} more; --json lists all"
                lines.append(format_step(CheckResult(group, "failed", more)))
        elif group in found.checked:
            lines.append(format_step(CheckResult(group, "ok", found.checked[group])))
        else:
            lines.append(format_step(CheckResult(group, "skipped", "not checked")))
    if not found.findings and "recordings" not in found.checked:
        lines.append("No problem was found, but no service has used this folder yet: check that it is the right one.")
    elif not found.findings:
        lines.append("No problem was found.")
    else:
        repairable = sum(finding.repairable for finding in found.findings)
        lines.append(f"{len(found.findings)} findings; --repair can repair {repairable} of them.")
    return "\n".join(lines)


def _step(finding: Finding) -> CheckResult:
    return CheckResult(finding.group, "failed", f"{finding.where}: {finding.what} ({finding.code})", finding.what_to_do)
