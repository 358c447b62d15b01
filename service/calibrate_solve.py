"""`pointchain calibrate solve`: a calibration from a folder of images and poses, or again from its observations."""

import json
import sys
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

from calibration.detection import BoardSighting
from calibration.errors import BoardDetectionError, HandEyeError
from calibration.folder import HAND_EYE, read_folder
from calibration.hand_eye import solve_hand_eye
from calibration.hand_eye_result import HandEyeResult
from calibration.observations import Observations
from calibration.observations_file import OBSERVATIONS, load_kept_observations
from calibration.observe import observe
from calibration.result_document import result_document
from calibration.storage import write_result
from calibration.verification import Verification, verify
from calibration.verified import verification_findings
from service.calibrate_words import result_words, verification_words
from service.problems import problem_document


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

    0 when it may be used, 1 when it is refused or cannot be solved.
    """
    path = out or folder / HAND_EYE
    try:
        seen = _kept(folder) if again else _found(folder)
        result, verification = _solved(seen)
        told = None if verification is None else verification.to_json()
        write_result(path, result, seen.observations, datetime.now(UTC), seen.held_out, told)
    except (HandEyeError, BoardDetectionError) as error:
        return _failed(error.slug, str(error), as_json)
    except OSError as error:
        return _failed("file", f"{error.filename or path} cannot be written: {error.strerror or error}", as_json)
    if as_json:
        unseen = [{"name": name, "reason": reason} for name, reason in seen.unseen]
        document = result_document(result, seen.observations, told)
        print(json.dumps(document | {"unseen": unseen}, allow_nan=False))
    else:
        print(result_words(result, seen.unseen))
        print(verification_words(verification))
    say(f"wrote {path} and {path.with_name(OBSERVATIONS)}")
    return 1 if result.verdict == "refuse" else 0


def say(words: str) -> None:
    """To people."""
    print(f"pointchain calibrate: {words}", file=sys.stderr)


def _found(folder: Path) -> Seen:
    """What the images show. Raises HandEyeError, BoardDetectionError."""
    content = read_folder(folder)
    for name, reason in content.left_out:
        say(f"{name}: left out: {reason}")
    possible = len(content.setup.board.points)

    def told(name: str, sighting: BoardSighting | str) -> None:
        is_seen = not isinstance(sighting, str)
        say(f"{name}: {f'{len(sighting.ids)} of {possible} corners' if is_seen else sighting}")

    observed = observe(content, told)
    return Seen(observed.observations, observed.held_out, observed.unseen)


def _kept(folder: Path) -> Seen:
    """What was seen when the folder was solved before. Raises HandEyeError."""
    kept = load_kept_observations(folder / OBSERVATIONS)
    try:
        of_result = json.loads((folder / HAND_EYE).read_bytes())["observations_sha256"]
    except (OSError, ValueError, KeyError, TypeError):
        of_result = None  # solving does not need it
    if of_result is not None and of_result != kept.sha256:
        say(f"{OBSERVATIONS} is not what {HAND_EYE} was solved from: one of them was changed since")
    return Seen(kept.observations, kept.held_out, ())


def _solved(seen: Seen) -> tuple[HandEyeResult, Verification | None]:
    """The result, refused where the views that were held out contradict it. Raises HandEyeError."""
    result = solve_hand_eye(seen.observations)
    if not seen.held_out.views:
        return result, None
    verification = verify(result, seen.held_out)
    return replace(result, findings=(*result.findings, *verification_findings(verification))), verification


def _failed(slug: str, words: str, as_json: bool) -> int:
    if as_json:
        print(json.dumps({"error": problem_document(422, slug, words)}))
    say(words)
    return 1
