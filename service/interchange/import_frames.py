"""`pointchain import frames`: a folder of depth images to a recording, with a report on stderr."""

import argparse
import sys
from pathlib import Path

from calibration.errors import HandEyeError
from cell.frames import FramesRequest, ImportedFrames, import_frames
from cell.frames.table_fit import SURE_SHARE
from service.errors import INPUT_ERRORS
from service.interchange.scene_options import given_box, given_hand_eye, given_radius

MAX_TABLE_OFFSET_M = 0.003
"""Distance of the table from `--table-z` that causes a warning. Recognition corrects up to 4 mm, and poses err too."""

COMMAND = "pointchain import frames"


def import_recording(options: argparse.Namespace) -> int:
    """Import a folder of depth images and return the exit code.

    Args:
        options: Parsed options of `pointchain import frames`.
    """
    try:
        request = FramesRequest(
            **given_hand_eye(options, COMMAND),
            intrinsics=None if options.intrinsics is None else tuple(options.intrinsics),
            depth_unit_m=options.depth_unit,
            intensity=options.intensity,
            string_radius_m=given_radius(options),
            table_z_m=options.table_z,
            workspace_m=given_box(options),
        )
        imported = import_frames(options.folder, options.out, request)
    except (*INPUT_ERRORS, HandEyeError) as error:
        print(f"{COMMAND}: {error}", file=sys.stderr)
        return 1
    except OSError as error:
        print(f"{COMMAND}: {options.out} cannot be written: {error.strerror or error}", file=sys.stderr)
        return 1
    _report(imported, options.out, options.table_z)
    return 0


def _report(imported: ImportedFrames, out: Path, table_z_m: float) -> None:
    lines = [
        f"{imported.views} depth images of {imported.width}x{imported.height} pixels, camera matrix: "
        f"{imported.intrinsics}, poses: {imported.poses} ({imported.pose_name})",
        f"depth unit: {imported.unit_m:g} m ({imported.unit_source}); with it, {imported.table_share:.0%} of the "
        f"pixels are at the table, z = {table_z_m:g} m",
    ]
    if imported.recording_unit_m != imported.unit_m:
        lines.append(
            f"depths were rounded to counts of {imported.recording_unit_m:g} m, by up to "
            f"{imported.recording_unit_m / 2 * 1000:g} mm"
        )
    if imported.too_far:
        lines.append(f"{imported.too_far} pixels are beyond the range of the recording's 16 bits: they have no depth")
    if imported.table_offset_m is not None and abs(imported.table_offset_m) > MAX_TABLE_OFFSET_M:
        measured_m = table_z_m + imported.table_offset_m
        lines.append(
            f"warning: the images show the table at z = {measured_m:.4f} m, not {table_z_m:g} m: measure the height of "
            "the table and give --table-z, or check the poses, which move what the images show"
        )
    elif imported.table_share < SURE_SHARE:
        unit = (
            f"the depth unit ({imported.better_unit_m:g} m would fit)" if imported.better_unit_m else "the depth unit"
        )
        lines.append(
            f"warning: fewer than {SURE_SHARE:.0%} of the pixels are at the table: check {unit}, --table-z, the poses "
            "and the camera matrix"
        )
    print("\n".join([*lines, f"wrote {out}"]), file=sys.stderr)
