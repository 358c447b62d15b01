"""Print the grasps of a scan as JSON in the form of `moveit_msgs/Grasp`, the reachable ones first. It needs no ROS.

    python examples/moveit_grasps.py URL [SCAN] > grasps.json

Nothing moves. SCAN is the id of a scan; the default is the newest scan with a model. A token comes from
POINTCHAIN_TOKEN, if set.

MoveIt expects `grasp_pose` as the pose of the end effector's parent link, which is the flange and not the gripper. In
the description of UR arms, this link is `tool0`, and the base frame of Pointchain is `base`. (`base_link` is turned by
180 degrees about z.) `pre_grasp_approach` leads from the pre-grasp to the grasp, `post_grasp_retreat` back.

The position of the finger joint is assumed to be linear in the opening between the fingers. By default it is the
opening in metres. For a Robotiq 2F-85, give `--joint-closed 0.8 --joint-open 0.0`.

Message: https://docs.ros.org/en/noetic/api/moveit_msgs/html/msg/Grasp.html
"""

import argparse
import json
import os
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pointchain_client import Client, ClientError, Grasp

MIN_SHARE = 0.95
"""Share of the approach and of the retreat that MoveIt must find feasible. The rest is for its interpolation."""
POSTURE_TIME_S = 1
"""Time for a motion of the fingers."""


def quaternion(R: NDArray[np.float64]) -> list[float]:
    """Return the quaternion (x, y, z, w) of a rotation matrix (3, 3), with w >= 0."""
    (a, b, c), (d, e, f), (g, h, i) = R
    K = np.array(
        [
            [a - e - i, b + d, c + g, h - f],
            [b + d, e - a - i, f + h, c - g],
            [c + g, f + h, i - a - e, d - b],
            [h - f, c - g, d - b, a + e + i],
        ]
    )
    q = np.linalg.eigh(K)[1][:, -1]  # of the largest eigenvalue
    return (q if q[3] >= 0 else -q).tolist()


def message(grasp: Grasp, name: str, options: argparse.Namespace) -> dict[str, Any]:
    """Return a grasp as a `moveit_msgs/Grasp`.

    Args:
        grasp: A grasp with `T_base_flange`.
        name: Its `id`.
        options: Names of frame and joint, and limits, as `main` reads them.
    """
    motion = grasp.T_base_flange
    assert motion is not None
    header = {"frame_id": options.frame_id}
    approach_m, lift_m = (motion.grasp - start for start in (motion.pregrasp, motion.retreat))

    def translation(vector: NDArray[np.float64]) -> dict[str, Any]:
        distance = float(np.linalg.norm(vector))
        x, y, z = (vector / distance).tolist()
        return {
            "direction": {"header": header, "vector": {"x": x, "y": y, "z": z}},
            "desired_distance": distance,
            "min_distance": MIN_SHARE * distance,
        }

    def posture(opening_m: float) -> dict[str, Any]:
        share = opening_m / options.stroke_m
        position = options.joint_closed + share * (options.joint_open - options.joint_closed)
        point = {"positions": [position], "time_from_start": {"sec": POSTURE_TIME_S, "nanosec": 0}}
        return {"joint_names": [options.joint], "points": [point]}

    x, y, z = motion.grasp[:3, 3].tolist()
    return {
        "id": name,
        "pre_grasp_posture": posture(grasp.opening_m),
        "grasp_posture": posture(0.0),
        "grasp_pose": {
            "header": header,
            "pose": {
                "position": {"x": x, "y": y, "z": z},
                "orientation": dict(zip("xyzw", quaternion(motion.grasp[:3, :3]), strict=True)),
            },
        },
        "grasp_quality": grasp.score,
        "pre_grasp_approach": translation(approach_m[:3, 3]),
        "post_grasp_retreat": translation(-lift_m[:3, 3]),
        "max_contact_force": options.max_force,
        "allowed_touch_objects": options.touch,
    }


def preference(grasp: Grasp) -> int:
    """Return 0 for a grasp that the arm reaches, 1 if the reach was not determined, and 2 if it does not."""
    return 1 if grasp.reach is None else 0 if grasp.reach.reachable else 2


def main(options: argparse.Namespace) -> int:
    """Return 0 when grasps were printed, 1 when there is none that a program may carry out."""
    with Client(options.url, token=os.environ.get("POINTCHAIN_TOKEN")) as cell:
        scan = options.scan or next((scan.id for scan in cell.scans(state=["succeeded", "partial"])), None)
        if scan is None:
            sys.exit("moveit_grasps: the service has no scan with a model")
        model, found = cell.model(scan), cell.grasps(scan)
    usable = [
        grasp
        for grasp in found.grasps
        if grasp.trusted and model.trusted(grasp.chain) and grasp.T_base_flange is not None
    ]
    if not usable:
        print(f"moveit_grasps: scan {scan} has no grasp on a chain with the verdict accept", file=sys.stderr)
        return 1
    chosen = sorted(usable, key=preference)[: options.count]  # the sort keeps the order of the list
    print(json.dumps([message(grasp, f"{scan}/{grasp.id}", options) for grasp in chosen], indent=1))
    return 0


def arguments() -> argparse.Namespace:
    """Return the arguments of the command line."""
    parser = argparse.ArgumentParser(description="Prints the grasps of a scan as JSON of moveit_msgs/Grasp.")
    parser.add_argument("url", help="address of the service")
    parser.add_argument("scan", nargs="?", help="id of a scan (the newest with a model)")
    parser.add_argument("--count", type=int, default=20, help="largest number of grasps (%(default)s)")
    parser.add_argument("--frame-id", default="base", help="name of the robot's base frame (%(default)s)")
    parser.add_argument("--joint", default="finger_joint", help="name of the gripper's joint (%(default)s)")
    parser.add_argument("--stroke-m", type=float, default=0.085, help="largest opening, metres (%(default)s)")
    parser.add_argument("--joint-closed", type=float, default=0.0, help="joint position without opening (%(default)s)")
    parser.add_argument("--joint-open", type=float, default=0.085, help="joint position at the stroke (%(default)s)")
    parser.add_argument("--max-force", type=float, default=0.0, help="max_contact_force, N; 0: none (%(default)s)")
    parser.add_argument("--touch", action="append", default=[], metavar="OBJECT", help="object that may be touched")
    return parser.parse_args()


if __name__ == "__main__":
    try:
        sys.exit(main(arguments()))
    except ClientError as error:
        sys.exit(f"moveit_grasps: {error}")
