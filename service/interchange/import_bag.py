"""`pointchain import bag`: a ROS bag to a recording, with a report on stderr."""

import argparse
import sys
from pathlib import Path

from calibration.errors import HandEyeError
from cell.bag.import_bag import BagRequest, ImportedBag, import_bag
from cell.recording.errors import shown
from service.errors import INPUT_ERRORS
from service.interchange.scene_options import given_box, given_hand_eye, given_radius

COMMAND = "pointchain import bag"


def import_recording(options: argparse.Namespace) -> int:
    """Import a bag and return the exit code.

    Args:
        options: Parsed options of `pointchain import bag`.
    """
    try:
        imported = import_bag(options.bag, options.out, _request(options))
    except (*INPUT_ERRORS, HandEyeError) as error:
        print(f"{COMMAND}: {error}", file=sys.stderr)
        return 1
    except OSError as error:
        print(f"{COMMAND}: {options.out} cannot be written: {error.strerror or error}", file=sys.stderr)
        return 1
    _report(imported, options.out)
    return 0


def _request(options: argparse.Namespace) -> BagRequest:
    hand_eye = given_hand_eye(options, COMMAND)
    return BagRequest(
        depth_topic=options.depth_topic,
        info_topic=options.info_topic,
        intensity_topic=options.intensity_topic,
        base_frame=options.base_frame,
        flange_frame=options.flange_frame,
        camera_frame=options.camera_frame,
        depth_unit_m=options.depth_unit,
        rectified=options.rectified,
        string_radius_m=given_radius(options),
        table_z_m=options.table_z,
        workspace_m=given_box(options),
        **hand_eye,
    )


def _report(imported: ImportedBag, out: Path) -> None:
    topics, frames, stationary = imported.topics, imported.frames, imported.stationary
    counts = sorted({len(pose.frames) for pose in stationary.poses})
    images = f"{counts[0]}" if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
    lines = [
        f"depth images of {shown(topics.depth)}, lens of {shown(topics.info)}",
        f"frames {shown(frames.base)} (base), {shown(frames.flange)} (flange), {shown(frames.camera)} (camera)",
        f"{len(stationary.poses)} views of {images} images each; excluded are {stationary.moving} images taken in "
        f"motion and {stationary.unknown} without a known pose",
    ]
    if imported.intensity_topic is not None:
        lines.append(f"intensity images of {shown(imported.intensity_topic)}, aligned with the depth")
    if stationary.single:
        lines.append(
            "poses are too far apart in time to tell whether the arm stood still: each image was used as a view of its "
            "own"
        )
    if frames.base == "base_link":
        lines.append("on a UR arm, base_link is turned by 180 degrees about z against the base of the controller")
    print("\n".join([*lines, f"wrote {out}"]), file=sys.stderr)
