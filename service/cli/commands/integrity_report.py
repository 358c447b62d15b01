"""The doctor's findings, told thing by thing, and what is left of them behind a repair."""

import json
import sqlite3
import sys
from dataclasses import asdict
from pathlib import Path

from cell.self_test.check_result import CheckResult
from service.cli.commands.check import told_step
from service.config.loader import ConfigError, load_config
from service.integrity.check import Examination, examine, examined_by
from service.integrity.database_check import MOST_TOLD
from service.integrity.finding import GROUPS, Finding
from service.integrity.repair import repair
from service.storage.data_folder import DataFolderError


def doctor(config_file: Path | None, data_dir: Path | None, mend: bool, as_json: bool, quick: bool) -> int:
    """Looks at the configured store, and mends it if wanted; 0 when it is well, or is now; 1 when something is left."""
    try:
        store = examined_by(load_config(config_file, data_dir=data_dir), quick)
    except ConfigError as error:
        print(f"pointchain doctor: {error}", file=sys.stderr)
        return 1
    repaired: list[str] = []
    try:
        if mend and store.root.is_dir():

            def say(words: str) -> None:
                repaired.append(words)
                print(f"pointchain doctor: {words}", file=sys.stderr, flush=True)

            found = repair(store, say)
        else:
            found = examine(store)
    except (DataFolderError, OSError, sqlite3.Error) as error:
        print(f"pointchain doctor: {error}", file=sys.stderr)
        return 1
    print(json.dumps(_document(store.root, found, repaired)) if as_json else _told(found))
    return 1 if found.findings else 0


def _document(root: Path, found: Examination, repaired: list[str]) -> dict[str, object]:
    findings = [{name: value for name, value in asdict(one).items() if name != "key"} for one in found.findings]
    return {
        "well": not findings,
        "data_dir": str(root),
        "service_runs": found.service_runs,
        "findings": findings,
        "repaired": repaired,
    }


def _told(found: Examination) -> str:
    lines = []
    for group in GROUPS:
        of_group = [finding for finding in found.findings if finding.group == group]
        if of_group:
            lines += [told_step(_step(finding)) for finding in of_group[:MOST_TOLD]]
            if len(of_group) > MOST_TOLD:
                more = f"and {len(of_group) - MOST_TOLD} more; --json tells all"
                lines.append(told_step(CheckResult(group, "failed", more)))
        elif group in found.looked_at:
            lines.append(told_step(CheckResult(group, "ok", found.looked_at[group])))
        else:
            lines.append(told_step(CheckResult(group, "skipped", "not looked at")))
    if not found.findings and "recordings" not in found.looked_at:
        lines.append("Nothing is wrong, but no service has used this folder yet: is it the one?")
    elif not found.findings:
        lines.append("The store is well.")
    else:
        mendable = sum(finding.repairable for finding in found.findings)
        lines.append(f"{len(found.findings)} findings, of which --repair sees to {mendable}.")
    return "\n".join(lines)


def _step(finding: Finding) -> CheckResult:
    return CheckResult(finding.group, "failed", f"{finding.where}: {finding.what} ({finding.code})", finding.what_to_do)
