"""Print a URScript program that carries out the best reachable grasp of a scan. It sends nothing to a robot.

    python examples/ur_script.py URL [SCAN] > grasp.script

SCAN is the id of a scan; the default is the newest scan with a model. A token comes from POINTCHAIN_TOKEN, if set.

The program is for the arm in its home posture, released by the service. It moves to the pre-grasp, opens the gripper,
goes along a straight line in the approach direction, closes the gripper, and lifts the string back along this line.
Replace the bodies of `open_gripper` and `close_gripper` by the commands of your gripper: until then, they ask a person.
The poses are those of the flange, so the tool centre point is set to the flange. Speeds are metres and radians per
second. Read the program before you run it, and run it at reduced speed first: neither this example nor the service is a
safety function.
"""

import argparse
import os
import sys
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from pointchain_client import Client, ClientError, Grasp, GraspList, Model

JOINT_SPEED, JOINT_ACCELERATION = 0.3, 0.5
LINEAR_SPEED, LINEAR_ACCELERATION = 0.05, 0.2
HOME_TOLERANCE_RAD = 0.01
"""Largest distance of a joint from the home posture at which the program begins."""
LOW_SCORE = 0.5
"""A grasp with a lower score gets a warning."""

PROGRAM = """\
# Grasp {grasp} of scan {scan}: chain {chain} at {s_mm:.0f} mm. Units: metres, radians.
def pointchain_grasp():
  def open_gripper(opening_mm):
    # REPLACE by the command of your gripper: open to opening_mm between the fingers.
    popup("Open the gripper to {opening_mm:.1f} mm between the fingers.", title="Gripper", blocking=True)
  end
  def close_gripper():
    # REPLACE by the command of your gripper.
    popup("Close the gripper.", title="Gripper", blocking=True)
  end

  # The path to the pre-grasp is free from the home posture only.
  local q_home = {q_home}
  local q_now = get_actual_joint_positions()
  local joint = 0
  while joint < 6:
    if norm(q_now[joint] - q_home[joint]) > {tolerance}:
      popup("The arm is not in its home posture.", title="Pointchain", error=True, blocking=True)
      halt
    end
    joint = joint + 1
  end

  set_tcp(p[0, 0, 0, 0, 0, 0])
  movej({q_pregrasp}, a={joint_a}, v={joint_v})
  open_gripper({opening_mm:.1f})
  movel({grasp_pose}, a={linear_a}, v={linear_v})
  close_gripper()
  movel({retreat_pose}, a={linear_a}, v={linear_v})
end
pointchain_grasp()
"""


def choose(model: Model, found: GraspList) -> Grasp | str:
    """Return the best grasp that a program may carry out, or the reason why there is none.

    Such a grasp is on a chain with the verdict `accept`. The arm reaches it, on a free path from the home posture, and
    no object is in the way of the lift.
    """
    trusted = [grasp for grasp in found.grasps if grasp.trusted and model.trusted(grasp.chain)]
    if not trusted:
        verdicts = ", ".join(f"{chain.id}: {chain.trust}" for chain in model.chains)
        return f"no grasp is on a chain with the verdict accept; the verdicts are {verdicts or 'none'}"
    if found.q_home_rad is None:
        return f"the reach was not determined: {found.no_reach_reason}"
    reached = [grasp for grasp in trusted if grasp.reach is not None and grasp.reach.reachable]
    if not reached:
        reasons = {grasp.reach.message for grasp in trusted if grasp.reach is not None}
        return f"the arm reaches none of {len(trusted)} grasps: {'; '.join(sorted(map(str, reasons)))}"
    for grasp in reached:
        if grasp.reach is not None and grasp.reach.path_free and grasp.object_above_m is None:
            return grasp
    return f"none of {len(reached)} reachable grasps has a free path from the home posture and a free lift"


def numbers(values: Iterable[float]) -> str:
    """Return a list of URScript."""
    return f"[{', '.join(f'{value:.9f}' for value in values)}]"


def pose(T: NDArray[np.float64]) -> str:
    """Return a pose (4, 4) of URScript: position and rotation vector."""
    return f"p{numbers([*T[:3, 3].tolist(), *rotation_vector(T[:3, :3]).tolist()])}"


def rotation_vector(R: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotation vector (3,) of a rotation matrix (3, 3)."""
    # by the quaternion, because a gripper that points down is turned by about pi, where the trace is not precise
    (a, b, c), (d, e, f), (g, h, i) = R
    K = np.array(
        [
            [a - e - i, b + d, c + g, h - f],
            [b + d, e - a - i, f + h, c - g],
            [c + g, f + h, i - a - e, d - b],
            [h - f, c - g, d - b, a + e + i],
        ]
    )
    x, y, z, w = np.linalg.eigh(K)[1][:, -1]  # the quaternion is the eigenvector of the largest eigenvalue
    axis = np.array([x, y, z]) if w >= 0 else -np.array([x, y, z])
    sine = float(np.linalg.norm(axis))
    return axis * (2 * np.arctan2(sine, abs(w)) / sine if sine > 0 else 2.0)


def program(scan: str, grasp: Grasp, found: GraspList) -> str:
    """Return the program that carries out a reachable grasp."""
    motion = grasp.T_base_flange
    reach = grasp.reach
    assert reach is not None
    assert reach.q_pregrasp_rad is not None
    assert found.q_home_rad is not None
    return PROGRAM.format(
        grasp=grasp.id,
        scan=scan,
        chain=grasp.chain,
        s_mm=grasp.s_m * 1000,
        opening_mm=grasp.opening_m * 1000,
        q_home=numbers(found.q_home_rad.tolist()),
        q_pregrasp=numbers(reach.q_pregrasp_rad.tolist()),
        grasp_pose=pose(motion.grasp),
        retreat_pose=pose(motion.retreat),
        tolerance=HOME_TOLERANCE_RAD,
        joint_a=JOINT_ACCELERATION,
        joint_v=JOINT_SPEED,
        linear_a=LINEAR_ACCELERATION,
        linear_v=LINEAR_SPEED,
    )


def notes(grasp: Grasp) -> list[str]:
    """Return what a person should know about a grasp before its program runs."""
    found = [f"grasp {grasp.id} has the score {grasp.score:.2f}"]
    if grasp.score < LOW_SCORE:
        found.append(f"warning: the score is below {LOW_SCORE}; check the grasp before you run the program")
    others = [str(chain) for chain in grasp.chains_above if chain != grasp.chain]
    above = ["a part of the same string"] if grasp.chain in grasp.chains_above else []
    if others:
        above.append(f"{'chain' if len(others) == 1 else 'chains'} {', '.join(others)}")
    if above:
        found.append(f"the lift takes along what lies over the string: {' and '.join(above)}")
    return found


def main(url: str, scan: str | None) -> int:
    """Return 0 when a program was printed, 1 when a person must decide."""
    with Client(url, token=os.environ.get("POINTCHAIN_TOKEN")) as cell:
        scan = scan or next((each.id for each in cell.scans(state=["succeeded", "partial"])), None)
        if scan is None:
            sys.exit("ur_script: the service has no scan with a model")
        model, found = cell.model(scan), cell.grasps(scan)
    grasp = choose(model, found)
    if isinstance(grasp, str):
        print(f"ur_script: scan {scan}: {grasp}", file=sys.stderr)
        return 1
    for note in notes(grasp):
        print(f"ur_script: {note}", file=sys.stderr)
    print(program(scan, grasp, found), end="")
    return 0


def arguments() -> argparse.Namespace:
    """Return the arguments of the command line."""
    parser = argparse.ArgumentParser(description="Prints a URScript program for the best reachable grasp of a scan.")
    parser.add_argument("url", help="address of the service")
    parser.add_argument("scan", nargs="?", help="id of a scan (the newest with a model)")
    return parser.parse_args()


if __name__ == "__main__":
    options = arguments()
    try:
        sys.exit(main(options.url, options.scan))
    except ClientError as error:
        sys.exit(f"ur_script: {error}")
