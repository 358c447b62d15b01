"""`pointchain calibrate solve`: a calibration from a folder of images and poses, or again from its observations."""

import json
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from calibration.dataset.folder import HAND_EYE_FILE, read_folder
from calibration.dataset.observations_file import OBSERVATIONS_FILE, load_observations
from calibration.dataset.view_detection import detect_views
from calibration.errors import BoardDetectionError, HandEyeError
from calibration.hand_eye import solve_hand_eye
from calibration.observations import Observations
from calibration.result import HandEyeResult
from calibration.storage.document import result_document
from calibration.storage.hand_eye_file import write_result
from calibration.target.detection import DetectedBoard
from calibration.verification.verification import Verification, verification_findings, verify
from service.cli.calibrate.activate import activation_command
from service.cli.calibrate.report import result_words, verification_words
from service.problems.document import error_document


@dataclass(frozen=True, eq=False)
class Seen:
    """What there is to solve from."""

    observations: Observations
    held_out: Observations
    """To verify by; may be none."""
    unseen: tuple[tuple[str, str], ...]
    """Views that gave nothing: name and reason."""


def calibrate_solve(folder: Path, again: bool, out: Path | None, as_json: bool) -> int:
    """Solves from the folder and writes the result there, or to `out`; the result as words, or JSON, on stdout.

    0 when it may be used, 1 when it is refused, cannot be solved, or cannot be written: it is told all the same.
    """
    path = out or folder / HAND_EYE_FILE
    try:
        seen = _kept(folder) if again else _found(folder)
        result, verification = _solved(seen)
    except (HandEyeError, BoardDetectionError) as error:
        return _failed(error_document(error.slug, str(error)), as_json)
    told = verification.to_json()
    problem = _written(path, result, seen, told)
    # It is told even where it cannot be kept.
    if as_json:
        document = result_document(result, seen.observations, told) if problem else json.loads(path.read_bytes())
        document |= {"unseen": [{"name": name, "reason": reason} for name, reason in seen.unseen]}
        print(json.dumps(document | ({"error": problem} if problem else {}), allow_nan=False))
    else:
        print(result_words(result, seen.unseen))
        print(verification_words(verification), flush=True)
    if problem:
        say(problem["detail"])
        return 1
    if not seen.held_out.views:
        say('to verify by views that are not solved from, write "held_out": true in the JSON files of two or more')
    say(f"wrote {path} and {path.with_name(OBSERVATIONS_FILE)}")
    if result.verdict != "refuse":
        say(f"to use it: {activation_command(path, None)}, with the --config of the cell if it has one")
    return 1 if result.verdict == "refuse" else 0


def say(words: str) -> None:
    """To people."""
    print(f"pointchain calibrate: {words}", file=sys.stderr)


def _found(folder: Path) -> Seen:
    """What the images show. Raises HandEyeError, BoardDetectionError."""
    content = read_folder(folder)
    for name, reason in content.excluded:
        say(f"{name}: left out: {reason}")
    possible = len(content.setup.board.points)

    def report_view(name: str, sighting: DetectedBoard | str) -> None:
        is_seen = not isinstance(sighting, str)
        say(f"{name}: {f'{len(sighting.ids)} of {possible} corners' if is_seen else sighting}")

    observed = detect_views(content, report_view)
    return Seen(observed.observations, observed.held_out, observed.excluded)


def _kept(folder: Path) -> Seen:
    """What was seen when the folder was solved before. Raises HandEyeError."""
    kept = load_observations(folder / OBSERVATIONS_FILE)
    try:
        of_result = json.loads((folder / HAND_EYE_FILE).read_bytes())["observations_sha256"]
    except (OSError, ValueError, KeyError, TypeError):
        of_result = None  # solving does not need it
    if of_result is not None and of_result != kept.sha256:
        say(f"{OBSERVATIONS_FILE} is not what {HAND_EYE_FILE} was solved from: one of them was changed since")
    return Seen(kept.observations, kept.held_out, ())


def _solved(seen: Seen) -> tuple[HandEyeResult, Verification]:
    """The result, refused where the views that were held out contradict it, and warned of where there are none. Raises
    HandEyeError."""
    result = solve_hand_eye(seen.observations)
    verification = verify(result, seen.held_out)
    return replace(result, findings=(*result.findings, *verification_findings(verification))), verification


def _written(path: Path, result: HandEyeResult, seen: Seen, verification: dict[str, Any]) -> dict[str, Any] | None:
    """Writes the result; the problem where it cannot be written."""
    try:
        write_result(path, result, seen.observations, seen.held_out, verification)
    except HandEyeError as error:
        return error_document(error.slug, str(error))
    except OSError as error:
        words = f"{error.filename or path} cannot be written: {error.strerror or error}"
        return error_document("file", words)
    return None


def _failed(problem: dict[str, Any], as_json: bool) -> int:
    if as_json:
        print(json.dumps({"error": problem}))
    say(problem["detail"])
    return 1
