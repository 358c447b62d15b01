"""Check of the grasps: how much of the table the gripper can reach."""

import itertools
from collections import Counter

import numpy as np
from numpy.typing import NDArray

from cell.config.cell_config import CellSettings
from cell.planning.grasp_reach import find_reach, reach_model
from cell.planning.home import home_posture
from cell.self_test.check_result import CheckContext, CheckResult, ok
from recognition.grasping.flange_poses import flange_poses

NAME = "grasps"
GRID = 5
"""Number of equal tiles of the workspace in each direction. There are grasps in the middle of each tile."""
DIRECTIONS = 4
"""Number of closing directions at each position. A turn by pi is the same grasp."""
ASSUMED_RADIUS_M = 0.004
"""Radius of the string if the configuration has none."""
MAX_REASONS = 3
"""Maximum number of reasons in the message."""
MIN_SHARE = 0.8
"""Smallest share of the grasps that is reached without a warning. In the simulated cell, 98 to 100 % are reached with
each preset. Beside the base, the gripper may come too near the shoulder."""

ADVICE: dict[str, str] = {
    "out-of-reach": "move the workspace within the arm's reach by x_m and y_m in [workspace]",
    "joint-limit": "move the workspace by x_m and y_m in [workspace]",
    "singular": "move the workspace by x_m and y_m in [workspace], so that the arm is neither stretched nor folded",
    "no-straight-descent": "move the workspace by x_m and y_m in [workspace]",
    "collision-arm": "move the workspace by x_m and y_m in [workspace], and check obstacles_m and clearance_m in "
    "[mounting]",
    "collision-camera": "use a longer gripper or mount the camera farther from the fingertips; check length_m in "
    "[gripper] and body_m in [camera]",
    "collision-gripper": "check the dimensions in [gripper], and obstacles_m and clearance_m in [mounting]",
}
"""What to do about the most frequent reason, by `ReachReason`."""


def grasps(context: CheckContext) -> CheckResult:
    """Check that the arm reaches grasps on the table, over the whole workspace."""
    settings, gripper = context.settings, context.settings.gripper.to_gripper()
    assert context.hand_eye is not None
    T_flange_camera = context.hand_eye.T_flange_camera
    model = reach_model(settings, T_flange_camera, gripper, home_posture(settings, T_flange_camera))
    radius_m = settings.scan.string_radius_m or ASSUMED_RADIUS_M
    T_base_grasp = upright_grasps(settings, radius_m)
    count = len(T_base_grasp)
    poses = flange_poses(T_base_grasp, np.full(count, radius_m - min(gripper.table_clearance_m, radius_m)), gripper)
    opening_m = min(2 * radius_m + gripper.opening_margin_m, gripper.stroke_m)
    found = find_reach(model, poses, np.full(count, opening_m), check_paths=False)
    reached = sum(reach.reachable for reach in found)
    described = settings.gripper.is_described
    message = (
        f"{reached} of {count} upright grasps over the workspace reached, with a gripper of "
        f"{1000 * gripper.length_m:.0f} mm{'' if described else ', assumed because [gripper] does not describe one'}"
    )
    reasons = Counter((reach.reason, reach.message) for reach in found if not reach.reachable).most_common()
    message += "".join(f"; {number}: {text}" for (_, text), number in reasons[:MAX_REASONS])
    others = sum(number for _, number in reasons[MAX_REASONS:])
    message += f"; {others}: other reasons" if others else ""
    if not described or reached >= MIN_SHARE * count:
        return ok(NAME, message)
    return CheckResult(NAME, "warning", message, ADVICE[str(reasons[0][0][0])])


def upright_grasps(settings: CellSettings, radius_m: float) -> NDArray[np.float64]:
    """Return grasps (N, 4, 4) from straight above, of strings on the table, as `T_base_grasp`.

    Args:
        settings: Workspace and table of the cell.
        radius_m: Radius of the strings.
    """
    x_m, y_m, (table_z_m, _) = settings.workspace_m
    angles = np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    T = []
    shares = (np.arange(GRID) + 0.5) / GRID
    x_of, y_of = (low + (high - low) * shares for low, high in (x_m, y_m))
    for x, y, angle in itertools.product(x_of, y_of, angles):
        c, s = np.cos(angle), np.sin(angle)
        T.append([(c, s, 0.0, x), (s, -c, 0.0, y), (0.0, 0.0, -1.0, table_z_m + radius_m), (0.0, 0.0, 0.0, 1.0)])
    return np.array(T)
