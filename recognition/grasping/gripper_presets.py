"""Grippers on the market, with the sources of their dimensions.

The data sheets have drawings only, so most dimensions were read from the robot descriptions that the makers or others
publish. A dimension without a source is an assumption on the safe side: wider or thicker than the part looks. Check
`length_m` at the cell, because adapters and fingertips vary.

Sources:
    robotiq-2f-85: `robotiq/ros`, robotiq_2f_85_macro.urdf.xacro (joints of base, knuckles and fingertips), and
        `google-deepmind/mujoco_menagerie`, robotiq_2f85/2f85.xml (coupling of 10.8 mm, pads of 22 x 37.5 mm and 8 mm
        thickness). The fingertips are 149.3 mm from the gripper's base when open, and 13.5 mm farther when closed, as
        the four-bar linkage gives it. With the coupling, that is 160.1 and 173.6 mm. A grasp of a string is nearly
        closed. Assumed: thickness of the fingertip behind the pad, radius of the linkage's joints.
    robotiq-hand-e: `robotiq/ros`, robotiq_hand_e_macro.urdf.xacro (stroke, fingers from 99 to 132.5 mm above the
        gripper's base). Assumed: the coupling of the 2F-85, a body of 75 mm diameter, fingers of 24 x 12 mm.
    onrobot-rg2: `OnRobot/onrobot-ros2`, onrobot_rg2_macro.xacro (collision boxes of base, body, links and standard
        fingertips, joints of the linkage). The fingertips are 231 mm from the flange when closed, and 36 mm less when
        open. A grasp of a string is nearly closed.
    schunk-egp-50: a description of a ur5e cell with an EGP 50 (base plate of 75 mm diameter and 15 mm thickness, body
        of 50 x 30 x 115 mm, jaws of 15 mm). The stroke of 8 mm per jaw is that of Schunk's catalogue, from memory. The
        gripper comes without fingers. Assumed: fingers of 40 mm length, 10 mm width and 8 mm thickness.
"""

from dataclasses import replace
from typing import Literal

from recognition.grasping.gripper import Gripper, GripperBox

GripperPreset = Literal["robotiq-2f-85", "robotiq-hand-e", "onrobot-rg2", "schunk-egp-50"]

_ADAPTER_HALF_M = 0.0375
"""Half the width of an adapter between flange and gripper, which is as wide as a flange of the smaller UR arms."""


def _box(width_m: float, depth_m: float, from_m: float, to_m: float) -> GripperBox:
    """Return a box around the flange's axis: its size along x and y, and its range along z."""
    return GripperBox((-width_m / 2, -depth_m / 2, from_m), (width_m / 2, depth_m / 2, to_m))


PRESETS: dict[GripperPreset, Gripper] = {
    "robotiq-2f-85": Gripper(
        finger_width_m=0.022,
        finger_thickness_m=0.015,
        finger_depth_m=0.0375,
        stroke_m=0.085,
        palm_width_m=0.075,
        length_m=0.174,
        body_m=(_box(0.075, 0.075, 0.0, 0.105), _box(0.156, 0.040, 0.065, 0.1365)),
    ),
    "robotiq-hand-e": Gripper(
        finger_width_m=0.024,
        finger_thickness_m=0.012,
        finger_depth_m=0.0335,
        stroke_m=0.050,
        palm_width_m=0.075,
        length_m=0.1435,
        body_m=(_box(0.075, 0.075, 0.0, 0.110),),
    ),
    "onrobot-rg2": Gripper(
        finger_width_m=0.023,
        finger_thickness_m=0.0115,
        finger_depth_m=0.030,
        stroke_m=0.110,
        palm_width_m=0.037,
        length_m=0.231,
        body_m=(_box(0.075, 0.071, 0.0, 0.0675), _box(0.064, 0.037, 0.027, 0.146), _box(0.133, 0.023, 0.123, 0.201)),
    ),
    "schunk-egp-50": Gripper(
        finger_width_m=0.010,
        finger_thickness_m=0.008,
        finger_depth_m=0.040,
        stroke_m=0.016,
        palm_width_m=0.030,
        length_m=0.185,
        body_m=(_box(0.075, 0.075, 0.0, 0.015), _box(0.050, 0.030, 0.015, 0.145)),
    ),
}
"""Grippers by name."""


def with_adapter(gripper: Gripper, length_m: float) -> Gripper:
    """Return a gripper with another distance from the flange to the fingertips.

    The boxes of the body move with the fingertips. If the gripper is longer, a further box fills the gap at the flange.

    Args:
        gripper: The gripper on its usual coupling.
        length_m: Distance from the flange to the fingertips.
    """
    longer = length_m - gripper.length_m
    body = []
    if longer > 0:
        body.append(_box(2 * _ADAPTER_HALF_M, 2 * _ADAPTER_HALF_M, 0.0, longer))
    for box in gripper.body_m:
        low_x, low_y, low_z = box.low_m
        high_x, high_y, high_z = box.high_m
        if high_z + longer > 0:
            body.append(GripperBox((low_x, low_y, max(low_z + longer, 0.0)), (high_x, high_y, high_z + longer)))
    return replace(gripper, length_m=length_m, body_m=tuple(body))
