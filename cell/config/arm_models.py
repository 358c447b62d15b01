"""Models of the arm.

This module does without Pydantic, whose import takes a third of the start of the virtual controller.
"""

from typing import Literal

ArmModelName = Literal["ur3e", "ur5e", "ur10e"]
BASE_RADIUS_M: dict[ArmModelName, float] = {"ur3e": 0.064, "ur5e": 0.075, "ur10e": 0.095}
"""Of the arm's base about its axis, by the maker's drawings: half the width of its foot."""


def simulated_serial(model: ArmModelName) -> str:
    """Return the serial number that the virtual controller of this model reports."""
    return f"2025{int(model[2:-1]):02d}0001"
