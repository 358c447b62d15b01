"""Read and write `observations.json`, the raw observations from which a calibration can be solved again.

It has the members of `setup.json` and `views`. Each view has its name, `T_base_flange` (4x4), the `ids` and `pixels` of
the corners, `corner_sigma_px`, and `held_out` (used for verification only). Numbers have full precision, so that
solving again gives the same result. `corner_sigma_px` is the accuracy that the detector reports (null if not known). It
helps people to find a bad image; the solver estimates the noise itself.
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
"""Maximum size of the file."""
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
    """Views to solve from."""
    held_out: Observations
    """Views for verification; often none."""
    sha256: str
    """SHA-256 of the content of the file, hexadecimal."""


def load_observations(path: str | os.PathLike[str]) -> StoredObservations:
    """Return all observations of a calibration.

    Args:
        path: The file `observations.json`.

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
    """Write the observations of a calibration in one step, synced to the disk.

    Args:
        path: The file `observations.json`.
        observations: Views to solve from.
        held_out: Views for verification. None: there are none.

    Returns:
        SHA-256 of the content, hexadecimal.

    Raises:
        OSError: The file cannot be written.
    """
    views = [_view_to_json(view, False) for view in observations.views]
    views += [_view_to_json(view, True) for view in held_out.views] if held_out is not None else []
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
