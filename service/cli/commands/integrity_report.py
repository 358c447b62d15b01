"""`pointchain doctor`: check the integrity of the data folder, repair it if requested, and print the findings."""

import json
import sqlite3
import sys
from dataclasses import asdict
from pathlib import Path

from cell.self_test.check_result import CheckResult
from service.cli.commands.check import format_step
from service.config.loader import ConfigError, load_config
from service.integrity.check import CheckReport, check_store, check_target
from service.integrity.database_check import MAX_REPORTED
from service.integrity.finding import GROUPS, Finding
from service.integrity.repair import repair
from service.storage.data_folder import DataFolderError


def run_doctor(config_file: Path | None, data_dir: Path | None, with_repair: bool, as_json: bool, quick: bool) -> int:
    """Check the configured data folder, repair it if requested, and print the findings.

    Args:
        config_file: Configuration of the service. None: the default one.
        data_dir: Data folder. None: the configured one.
        with_repair: Repair what can be repaired, then check again.
        as_json: Print JSON.
        quick: Compare sizes only; read no file.

    Returns:
        The exit code: 0 if nothing was found, or nothing remains after the repair; else 1.
    """
    try:
        store = check_target(load_config(config_file, data_dir=data_dir), quick)
    except ConfigError as error:
        print(f"pointchain doctor: {error}", file=sys.stderr)
        return 1
    repaired: list[str] = []
    try:
        if with_repair and store.root.is_dir():

            def report(message: str) -> None:
                repaired.append(message)
                print(f"pointchain doctor: {message}", file=sys.stderr, flush=True)

            found = repair(store, report)
        else:
            found = check_store(store)
    except (DataFolderError, OSError, sqlite3.Error) as error:
        print(f"pointchain doctor: {error}", file=sys.stderr)
        return 1
    print(json.dumps(_document(store.root, found, repaired)) if as_json else _format_report(found))
    return 1 if found.findings else 0


def _document(root: Path, found: CheckReport, repaired: list[str]) -> dict[str, object]:
    findings = [{name: value for name, value in asdict(one).items() if name != "key"} for one in found.findings]
    return {
        "well": not findings,
        "data_dir": str(root),
        "service_runs": found.service_runs,
        "findings": findings,
        "repaired": repaired,
    }


def _format_report(found: CheckReport) -> str:
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
