"""The raw observations of a calibration on disk, `observations.json`: with them it can be solved again.

What the folder form's `setup.json` holds, and `views`: for each its name, `T_base_flange` (4x4), the corners' `ids` and
`pixels`, `corner_sigma_px`, and whether it was `held_out`, to verify by. Numbers are written in full: what is solved
again gives the same result. `corner_sigma_px`, how exactly the detector says it found the corners (null: not told), is
for people who look for a bad picture; the solver estimates the noise by itself.
"""

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from calibration.dataset.atomic_write import read_in_folder, replace_synced
from calibration.dataset.forms import Form, Transform, read_form
from calibration.dataset.setup import Setup, SetupForm, setup_document
from calibration.errors import CalibrationFolderError
from calibration.observations import BoardView, Observations

__all__ = ["OBSERVATIONS", "StoredObservations", "load_observations", "write_observations"]

OBSERVATIONS = "observations.json"
LARGEST_BYTES = 64 << 20
MOST_VIEWS = 1000


class _View(Form):
    name: str
    held_out: bool = False
    T_base_flange: Transform
    ids: Annotated[list[int], Field(fail_fast=True)]
    pixels: Annotated[list[Annotated[list[float], Field(min_length=2, max_length=2)]], Field(fail_fast=True)]
    corner_sigma_px: float | None = None


class _ObservationsForm(SetupForm, extra="ignore"):
    views: Annotated[list[_View], Field(max_length=MOST_VIEWS)]


@dataclass(frozen=True, eq=False)
class StoredObservations:
    """All of a file."""

    observations: Observations
    """To solve from."""
    held_out: Observations
    """To verify by; often without views."""
    sha256: str
    """Of the file's content, hexadecimal."""


def load_observations(path: Path) -> StoredObservations:
    """All observations of a calibration. Raises CalibrationFolderError: there is no such file, or it is no such one."""
    content = read_in_folder(path, LARGEST_BYTES, "solve from the images first")
    form = read_form(_ObservationsForm, content, path, CalibrationFolderError)
    setup = form.setup()
    corners = len(setup.board.points)
    views = [(_seen(view, f"{path}: view {view.name!r}", corners), view.held_out) for view in form.views]
    names = [view.name for view, _ in views]
    if twice := next((name for name in names if names.count(name) > 1), None):
        raise CalibrationFolderError(f"{path} has two views {twice!r}: each needs a name of its own")
    return StoredObservations(
        setup.observations(tuple(view for view, held_out in views if not held_out)),
        setup.observations(tuple(view for view, held_out in views if held_out)),
        hashlib.sha256(content).hexdigest(),
    )


def write_observations(path: Path, observations: Observations, held_out: Observations | None = None) -> str:
    """Writes the file, in one step and synced; the SHA-256 of its content.

    Raises:
        OSError: the file cannot be written.
    """
    views = [_document(view, False) for view in observations.views]
    views += [_document(view, True) for view in held_out.views] if held_out is not None else []
    document = setup_document(Setup.of(observations)) | {"views": views}
    content = json.dumps(document, allow_nan=False).encode()
    replace_synced(path, content)
    return hashlib.sha256(content).hexdigest()


def _seen(view: _View, where: str, corners: int) -> BoardView:
    if len(view.ids) != len(view.pixels):
        raise CalibrationFolderError(f"{where} has {len(view.ids)} ids and {len(view.pixels)} pixels")
    if len(set(view.ids)) != len(view.ids) or not set(view.ids) <= set(range(corners)):
        raise CalibrationFolderError(
            f"{where}: ids are not numbers of corners, each once from 0 to {corners - 1}: is it another board's?"
        )
    return BoardView(
        name=view.name,
        T_base_flange=view.T_base_flange,
        ids=np.array(view.ids, dtype=np.int64),
        pixels=np.array(view.pixels).reshape(-1, 2),
        corner_sigma_px=view.corner_sigma_px,
    )


def _document(view: BoardView, held_out: bool) -> dict[str, Any]:
    return {
        "name": view.name,
        "held_out": held_out,
        "T_base_flange": view.T_base_flange.tolist(),
        "ids": view.ids.tolist(),
        "pixels": view.pixels.tolist(),
        "corner_sigma_px": view.corner_sigma_px,
    }
