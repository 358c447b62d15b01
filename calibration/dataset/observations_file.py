"""Read and write `observations.json`, the observations from which a calibration can be solved again.

The file has the members of `setup.json`, and `views`. Each view has the members

    name             name of the view
    held_out         whether the view is used for verification only
    T_base_flange    4x4 matrix, metres
    ids, pixels      numbers and pixels of the detected corners
    corner_sigma_px  standard deviation of the corner noise reported by the detector, or null if unknown

Numbers have full precision, so that solving again gives the same result. `corner_sigma_px` helps people to find a bad
image. The solver ignores `corner_sigma_px` and estimates the noise.
"""

import hashlib
import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from calibration.atomic_write import read_calibration_file, replace_synced
from calibration.dataset.forms import Form, Transform, parse_form
from calibration.dataset.setup import Setup, SetupForm, setup_to_json
from calibration.errors import CalibrationFolderError
from calibration.observations import BoardView, Observations

__all__ = ["OBSERVATIONS_FILE", "StoredObservations", "load_observations", "write_observations"]

OBSERVATIONS_FILE = "observations.json"
"""Name of the file in a calibration folder."""
MAX_BYTES = 64 << 20
"""Maximum size of the file, bytes."""
MAX_VIEWS = 1000
"""Maximum number of views."""


class _ViewForm(Form):
    name: str
    held_out: bool = False
    T_base_flange: Transform
    ids: Annotated[list[int], Field(fail_fast=True)]
    pixels: Annotated[list[Annotated[list[float], Field(min_length=2, max_length=2)]], Field(fail_fast=True)]
    corner_sigma_px: float | None = None


class _ObservationsForm(SetupForm, extra="ignore"):
    views: Annotated[list[_ViewForm], Field(max_length=MAX_VIEWS)]


@dataclass(frozen=True, eq=False)
class StoredObservations:
    """The content of `observations.json`."""

    observations: Observations
    """Observations with the views for the solver."""
    held_out: Observations
    """Observations with the views for verification, which may be empty."""
    sha256: str
    """SHA-256 of the file content, hexadecimal."""


def load_observations(path: str | os.PathLike[str]) -> StoredObservations:
    """Read the file `observations.json` of a calibration.

    Args:
        path: The file.

    Raises:
        CalibrationFolderError: The file is missing or not valid.
    """
    path = Path(path)
    content = read_calibration_file(path, MAX_BYTES, "solve from the images first")
    form = parse_form(_ObservationsForm, content, path, CalibrationFolderError)
    setup = form.to_setup()
    corners = len(setup.board.points)
    views = [(_to_view(view, f"{path}: view {view.name!r}", corners), view.held_out) for view in form.views]
    names = [view.name for view, _ in views]
    if repeated := next((name for name in names if names.count(name) > 1), None):
        raise CalibrationFolderError(f"{path} has two views named {repeated!r}: give each view its own name")
    return StoredObservations(
        setup.observations(tuple(view for view, held_out in views if not held_out)),
        setup.observations(tuple(view for view, held_out in views if held_out)),
        hashlib.sha256(content).hexdigest(),
    )


def write_observations(
    path: str | os.PathLike[str], observations: Observations, held_out: Observations | None = None
) -> str:
    """Write the file `observations.json` of a calibration atomically, and sync it to the disk.

    Args:
        path: The file. An existing file is replaced.
        observations: Observations with the views for the solver.
        held_out: Observations with the views for verification, or None if no view is held out.

    Returns:
        SHA-256 of the file content, hexadecimal.

    Raises:
        OSError: The file cannot be written.
    """
    views = [_view_to_json(view, held_out=False) for view in observations.views]
    if held_out is not None:
        views += [_view_to_json(view, held_out=True) for view in held_out.views]
    document = setup_to_json(Setup.from_observations(observations)) | {"views": views}
    content = json.dumps(document, allow_nan=False).encode()
    replace_synced(path, content)
    return hashlib.sha256(content).hexdigest()


def _to_view(view: _ViewForm, source: str, corners: int) -> BoardView:
    if len(view.ids) != len(view.pixels):
        raise CalibrationFolderError(
            f"{source} has {len(view.ids)} ids and {len(view.pixels)} pixels: give one pixel for each id"
        )
    if len(set(view.ids)) != len(view.ids) or not set(view.ids) <= set(range(corners)):
        raise CalibrationFolderError(
            f"{source}: ids are not different corner numbers from 0 to {corners - 1}: check that it is of this board"
        )
    return BoardView(
        name=view.name,
        T_base_flange=view.T_base_flange,
        ids=np.array(view.ids, dtype=np.int64),
        pixels=np.array(view.pixels).reshape(-1, 2),
        corner_sigma_px=view.corner_sigma_px,
    )


def _view_to_json(view: BoardView, held_out: bool) -> dict[str, Any]:
    return {
        "name": view.name,
        "held_out": held_out,
        "T_base_flange": view.T_base_flange.tolist(),
        "ids": view.ids.tolist(),
        "pixels": view.pixels.tolist(),
        "corner_sigma_px": view.corner_sigma_px,
    }
