"""`pointchain camera-profile`: a recording to the file of a simulated camera with the same errors."""

import argparse
import sys
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from calibration.atomic_write import replace_synced
from cell.camera_profile.depth_profile import (
    ERRORS_M,
    QUANTITY_NAMES,
    DepthProfile,
    ProfileError,
    format_quantity,
    from_document,
)
from cell.camera_profile.measure import PoseImages
from cell.config.camera_names import PRESET_SUFFIX, is_preset_path
from cell.config.camera_preset import CameraPreset, to_text
from cell.devices import View
from cell.recording import read_recording
from service.errors import INPUT_ERRORS

if TYPE_CHECKING:
    from cell.simulation.profiling.camera_fit import FitOptions

COMMAND = "pointchain camera-profile"
SAME_POSE = 1e-4
"""Largest difference of the entries of two camera poses that are the same (translation in metres)."""
SINGLE_SOURCE = "depth images"
"""Source of an imported recording whose images are single exposures."""


def pose_images(views: Sequence[View]) -> list[PoseImages]:
    """Return the depth images of views by pose, in the order of the first view of each pose."""
    groups: list[list[View]] = []
    for view in views:
        same = [group for group in groups if _is_same_pose(group[0], view)]
        if same:
            same[0].append(view)
        else:
            groups.append([view])
    return [PoseImages(np.stack([view.depth for view in group]), group[0].depth_unit_m, group[0].K) for group in groups]


def has_single_exposures(provenance: Mapping[str, str]) -> bool:
    """Return whether the images of a recording are single exposures, by its provenance."""
    return provenance.get("source") == SINGLE_SOURCE


def report(preset: CameraPreset) -> str:
    """Return the measured and the simulated errors of a camera and its parameters, for a person."""
    measured = from_document(preset.measured)
    simulated = from_document(preset.reproduced)
    lines = [
        f"table of {measured.poses} poses, {measured.distance_m:.2f} m away, {measured.table_pixels} pixels",
        f"{'':<22}{'measured':<28}simulated",
    ]
    for name, text in QUANTITY_NAMES.items():
        lines.append(f"{text:<22}{_shown(measured, name):<28}{_shown(simulated, name)}")
    for name, source in preset.sources.items():
        lines.append(f"{name} = {_parameter(preset, name)} ({source})")
    return "\n".join([*lines, *preset.notes])


def profile_recording(options: argparse.Namespace) -> int:
    """Make a camera file of a recording and return the exit code.

    Args:
        options: Parsed options of `pointchain camera-profile`.
    """
    from cell.simulation.profiling.camera_fit import FitOptions

    if not is_preset_path(options.out):
        message = f"{options.out} must end with {PRESET_SUFFIX}, because cameras are named by it"
        print(f"{COMMAND}: {message}", file=sys.stderr)
        return 1
    if options.out.exists():
        print(f"{COMMAND}: {options.out} exists already; nothing is overwritten", file=sys.stderr)
        return 1
    try:
        recording = read_recording(options.recording)
        is_single = options.single or has_single_exposures(recording.header.provenance)
        preset = _fitted(recording.views, FitOptions(base=options.like, is_median=not is_single))
        replace_synced(options.out, to_text(preset).encode())
    except (*INPUT_ERRORS, ProfileError) as error:
        print(f"{COMMAND}: {error}", file=sys.stderr)
        return 1
    except OSError as error:
        print(f"{COMMAND}: {options.out} cannot be written: {error.strerror or error}", file=sys.stderr)
        return 1
    print(report(preset))
    print(f"wrote {options.out}", file=sys.stderr)
    return 0


def _fitted(views: Sequence[View], options: "FitOptions") -> CameraPreset:
    """Return the camera of the views."""
    from cell.simulation.profiling.camera_fit import fit_camera

    print("measuring the table, and comparing it with simulated tables; this takes about a minute", file=sys.stderr)
    return fit_camera(pose_images(views), options)


def _is_same_pose(one: View, other: View) -> bool:
    """Return whether two views with images of one size are from the same pose."""
    is_near = np.allclose(one.T_base_camera, other.T_base_camera, rtol=0, atol=SAME_POSE)
    return is_near and one.depth.shape == other.depth.shape


def _shown(profile: DepthProfile, name: str) -> str:
    """Return a measured value with its unit."""
    value = getattr(profile, name)
    if value is None:
        return "unknown"
    text = format_quantity(name, value)
    pixels = profile.in_pixels(value) if name in ERRORS_M else None
    return text if pixels is None else f"{text}, {pixels:.3f} disparities"


def _parameter(preset: CameraPreset, name: str) -> str:
    """Return the value of a parameter."""
    value = getattr(preset, name)
    return f"{value:.4g}" if isinstance(value, float) else str(value)
