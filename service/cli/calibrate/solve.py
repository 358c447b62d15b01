"""`pointchain calibrate solve`: solve a calibration from a folder of images and poses, or from its observations."""

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
from service.cli.calibrate.report import format_result, format_verification
from service.problems.document import error_document


@dataclass(frozen=True, eq=False)
class SolverInput:
    """Observations of a folder."""

    observations: Observations
    """Views to solve from."""
    held_out: Observations
    """Views for the verification. It may have none."""
    unusable: tuple[tuple[str, str], ...]
    """(name, reason) of each view without an observation."""


def calibrate_solve(folder: Path, again: bool, out: Path | None, as_json: bool) -> int:
    """Solve from a folder, write the result, and print it to stdout.

    Args:
        folder: Folder with images and poses.
        again: Solve from the observations in the folder, without the images.
        out: File for the result. None: `hand_eye.json` in the folder.
        as_json: Print JSON.

    Returns:
        The exit code: 0 if the result may be used; 1 if it is refused, cannot be solved or cannot be written. A result
        that cannot be written is printed too.
    """
    path = out or folder / HAND_EYE_FILE
    try:
        solver_input = _load_observations(folder) if again else _detect(folder)
        result, verification = _solve(solver_input)
    except (HandEyeError, BoardDetectionError) as error:
        return _fail(error_document(error.slug, str(error)), as_json)
    verification_json = verification.to_json()
    problem = _write(path, result, solver_input, verification_json)
    # the result is printed even if it cannot be written
    if as_json:
        if problem:
            document = result_document(result, solver_input.observations, verification_json)
        else:
            document = json.loads(path.read_bytes())
        document |= {"unseen": [{"name": name, "reason": reason} for name, reason in solver_input.unusable]}
        print(json.dumps(document | ({"error": problem} if problem else {}), allow_nan=False))
    else:
        print(format_result(result, solver_input.unusable))
        print(format_verification(verification), flush=True)
    if problem:
        _report(problem["detail"])
        return 1
    if not solver_input.held_out.views:
        _report('no view is held out for a verification: write "held_out": true in the JSON files of two or more views')
    _report(f"wrote {path} and {path.with_name(OBSERVATIONS_FILE)}")
    if result.verdict != "refuse":
        _report(f"to activate it: {activation_command(path, None)}, with the --config of the cell if it has one")
    return 1 if result.verdict == "refuse" else 0


def _report(message: str) -> None:
    print(f"pointchain calibrate: {message}", file=sys.stderr)


def _detect(folder: Path) -> SolverInput:
    """Detect the board in the images of a folder.

    Raises:
        HandEyeError: The folder cannot be read.
        BoardDetectionError: The board cannot be detected.
    """
    content = read_folder(folder)
    for name, reason in content.excluded:
        _report(f"{name}: excluded: {reason}")
    possible = len(content.setup.board.points)

    def report_view(name: str, detection: DetectedBoard | str) -> None:
        is_detected = not isinstance(detection, str)
        _report(f"{name}: {f'{len(detection.ids)} of {possible} corners' if is_detected else detection}")

    detected = detect_views(content, report_view)
    return SolverInput(detected.observations, detected.held_out, detected.excluded)


def _load_observations(folder: Path) -> SolverInput:
    """Load the observations of an earlier solution.

    Raises:
        HandEyeError: The observations cannot be loaded.
    """
    loaded = load_observations(folder / OBSERVATIONS_FILE)
    try:
        sha256_of_result = json.loads((folder / HAND_EYE_FILE).read_bytes())["observations_sha256"]
    except (OSError, ValueError, KeyError, TypeError):
        sha256_of_result = None  # the former result is not needed
    if sha256_of_result is not None and sha256_of_result != loaded.sha256:
        _report(f"{HAND_EYE_FILE} was not solved from this {OBSERVATIONS_FILE}: one of them was changed since")
    return SolverInput(loaded.observations, loaded.held_out, ())


def _solve(solver_input: SolverInput) -> tuple[HandEyeResult, Verification]:
    """Return the result and its verification.

    The result is refused if the held-out views contradict it, and has a warning if there are none.

    Raises:
        HandEyeError: The calibration cannot be solved.
    """
    result = solve_hand_eye(solver_input.observations)
    verification = verify(result, solver_input.held_out)
    return replace(result, findings=(*result.findings, *verification_findings(verification))), verification


def _write(
    path: Path, result: HandEyeResult, solver_input: SolverInput, verification: dict[str, Any]
) -> dict[str, Any] | None:
    """Write the result. Return the problem if it cannot be written."""
    try:
        write_result(path, result, solver_input.observations, solver_input.held_out, verification)
    except HandEyeError as error:
        return error_document(error.slug, str(error))
    except OSError as error:
        return error_document("file", f"{error.filename or path} cannot be written: {error.strerror or error}")
    return None


def _fail(problem: dict[str, Any], as_json: bool) -> int:
    if as_json:
        print(json.dumps({"error": problem}))
    _report(problem["detail"])
    return 1
