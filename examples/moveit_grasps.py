"""Print the reachable grasps of a scan as JSON in the form of ROS 2's `moveit_msgs/msg/Grasp`. It needs no ROS.

    python examples/moveit_grasps.py URL [SCAN] > grasps.json

Nothing moves. SCAN is the id of a scan; the default is the newest scan with a model. A token comes from
POINTCHAIN_TOKEN, if set.

Only grasps on chains with the verdict `accept` that the arm reaches are printed, the best first. The service determines
the reach for scans with the calibration that is active and the gripper that is configured. For other scans,
`--without-reach` prints all grasps unchecked: use it only if your planner checks joint limits and collisions itself.

MoveIt expects `grasp_pose` as the pose of the end effector's parent link, which is the flange and not the gripper. In
the description of UR arms, this link is `tool0`, and the base frame of Pointchain is `base`. (`base_link` is turned by
180 degrees about z.) `pre_grasp_approach` leads from the pre-grasp to the grasp, `post_grasp_retreat` back.

The position of the finger joint is assumed to be linear in the opening between the fingers. By default it is the
opening in metres. For a Robotiq 2F-85, give `--joint-closed 0.8 --joint-open 0.0`.

Message: https://docs.ros.org/en/jazzy/p/moveit_msgs/msg/Grasp.html. In the message of ROS 1, the members of
`time_from_start` are `secs` and `nsecs`.
"""

import argparse
import json
import os
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pointchain_client import Client, ClientError, Grasp, GraspList, Model

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
        grasp: The grasp.
        name: Its `id`.
        options: Names of frame and joint, and limits, as `main` reads them.
    """
    motion = grasp.T_base_flange
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


def choose(model: Model, found: GraspList, without_reach: bool) -> tuple[list[Grasp], str]:
    """Return the grasps that a planner may use, the best first, and a message about the others.

    Args:
        model: The model of the scan.
        found: Its grasps with their reach.
        without_reach: Whether grasps are returned whose reach was not determined.

    Returns:
        Grasps on chains with the verdict `accept`, none of them unreachable. If there is none, the message has the
        reason. The message is empty if no grasp is left out as unreachable, and the calibration is the same.
    """
    trusted = [grasp for grasp in found.grasps if grasp.trusted and model.trusted(grasp.chain)]
    if not trusted:
        verdicts = ", ".join(f"{chain.id}: {chain.trust}" for chain in model.chains)
        return [], f"no grasp is on a chain with the verdict accept; the verdicts are {verdicts or 'none'}"
    unknown = f"the reach was not determined: {found.no_reach_reason}"
    if found.same_gripper is False:  # the flange poses are for the other gripper
        return [], unknown
    if found.q_home_rad is None and not without_reach:
        return [], f"{unknown}, or give --without-reach if your planner checks joint limits and collisions"
    chosen = [grasp for grasp in trusted if (without_reach if grasp.reach is None else grasp.reach.reachable)]
    if not chosen:
        reasons = {grasp.reach.message for grasp in trusted if grasp.reach is not None}
        return [], f"the arm reaches none of {len(trusted)} grasps: {'; '.join(sorted(map(str, reasons)))}"
    if found.same_calibration is False:
        return chosen, "warning: the calibration has changed since, so the grasps may be beside the strings; scan again"
    unreachable = len(trusted) - len(chosen)
    return chosen, f"{unreachable} of {len(trusted)} grasps are left out as unreachable" if unreachable else ""


def main(options: argparse.Namespace) -> int:
    """Return 0 when grasps were printed, 1 when there is none that a planner may use."""
    with Client(options.url, token=os.environ.get("POINTCHAIN_TOKEN")) as cell:
        scan = options.scan or next((scan.id for scan in cell.scans(state=["succeeded", "partial"])), None)
        if scan is None:
            sys.exit("moveit_grasps: the service has no scan with a model")
        model, found = cell.model(scan), cell.grasps(scan)
    chosen, note = choose(model, found, options.without_reach)
    if note:
        print(f"moveit_grasps: scan {scan}: {note}", file=sys.stderr)
    if not chosen:
        return 1
    messages = [message(grasp, f"{scan}/{grasp.id}", options) for grasp in chosen[: options.count]]
    print(json.dumps(messages, indent=1))
    return 0


def positive(text: str) -> int:
    """Return a number of grasps, at least 1."""
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"it is {value}; it must be at least 1")
    return value


def arguments() -> argparse.Namespace:
    """Return the arguments of the command line."""
    parser = argparse.ArgumentParser(description="Prints the reachable grasps of a scan as moveit_msgs/msg/Grasp.")
    parser.add_argument("url", help="address of the service")
    parser.add_argument("scan", nargs="?", help="id of a scan (the newest with a model)")
    parser.add_argument("--count", type=positive, default=20, help="largest number of grasps (%(default)s)")
    parser.add_argument(
        "--without-reach",
        action="store_true",
        help="also print grasps whose reach was not determined, for planners that check it themselves",
    )
    parser.add_argument("--frame-id", default="base", help="name of the robot's base frame (%(default)s)")
    parser.add_argument("--joint", default="finger_joint", help="name of the gripper's joint (%(default)s)")
    parser.add_argument(
        "--stroke-m",
        type=float,
        default=0.085,
        help="largest opening, metres; it must match `stroke_m` of [gripper] in the service's configuration "
        "(%(default)s)",
    )
    parser.add_argument("--joint-closed", type=float, default=0.0, help="joint position without opening (%(default)s)")
    parser.add_argument("--joint-open", type=float, help="joint position at the stroke (the stroke)")
    parser.add_argument("--max-force", type=float, default=0.0, help="max_contact_force, N; 0: none (%(default)s)")
    parser.add_argument("--touch", action="append", default=[], metavar="OBJECT", help="object that may be touched")
    options = parser.parse_args()
    if options.joint_open is None:
        options.joint_open = options.stroke_m
    return options


if __name__ == "__main__":
    try:
        sys.exit(main(arguments()))
    except ClientError as error:
        sys.exit(f"moveit_grasps: {error}")
