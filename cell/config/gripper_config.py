"""Settings of the gripper: a preset, and single dimensions."""

from contextlib import suppress
from typing import Any, Self

from pydantic import model_validator

from cell.config.strict_model import StrictSettings, Vector3
from recognition.grasping.gripper import Gripper, GripperBox
from recognition.grasping.gripper_presets import PRESETS, GripperPreset, with_adapter


class GripperSettings(StrictSettings):
    """Gripper for the grasps, and for the collision checks. Most keys are the fields of `Gripper`."""

    preset: GripperPreset | None = None
    """Gripper whose dimensions are the defaults of all other keys. Without it, the defaults are those of this table."""
    finger_width_m: float = Gripper.finger_width_m
    finger_thickness_m: float = Gripper.finger_thickness_m
    finger_depth_m: float = Gripper.finger_depth_m
    stroke_m: float = Gripper.stroke_m
    palm_width_m: float = Gripper.palm_width_m
    opening_margin_m: float = Gripper.opening_margin_m
    clearance_m: float = Gripper.clearance_m
    table_clearance_m: float = Gripper.table_clearance_m
    min_table_clearance_m: float = Gripper.min_table_clearance_m
    length_m: float | None = None
    """Distance from the flange to the fingertips, with adapters, at the opening of a grasp (z). Without it, flange
    poses are for 0.174 m."""
    mounting_rotation_rad: float = Gripper.mounting_rotation_rad
    body_m: tuple[tuple[Vector3, Vector3], ...] = ()
    """Boxes between flange and fingers, each given by two opposite corners in a frame at the flange, with x along the
    closing direction and z out of the flange. Without a box, the palm reaches up to the flange."""

    @property
    def is_described(self) -> bool:
        """Whether the configuration describes the gripper as a body: by a preset, its length, or its boxes."""
        return self.preset is not None or self.length_m is not None or bool(self.body_m)

    def to_gripper(self) -> Gripper:
        """Return the gripper as recognition takes it."""
        values = {name: getattr(self, name) for name in Gripper.__dataclass_fields__}
        length = Gripper.length_m if self.length_m is None else self.length_m
        return Gripper(**values | {"length_m": length, "body_m": tuple(_box(*corners) for corners in self.body_m)})

    @model_validator(mode="before")
    @classmethod
    def _preset_values(cls, data: Any) -> Any:
        """Take the values of the preset for all keys that are not given."""
        presets: dict[Any, Gripper] = dict(PRESETS.items())
        if not isinstance(data, dict) or not isinstance(name := data.get("preset"), str) or name not in presets:
            return data
        preset = presets[name]
        with suppress(TypeError, ValueError):  # the validation of the field rejects such a length
            preset = with_adapter(preset, float(data.get("length_m", preset.length_m)))
        values = {name: getattr(preset, name) for name in Gripper.__dataclass_fields__}
        return values | {"body_m": tuple((box.low_m, box.high_m) for box in preset.body_m)} | data

    @model_validator(mode="after")
    def _check_gripper(self) -> Self:
        self.to_gripper()  # raises a ValueError that names the key
        return self


def _box(one: Vector3, other: Vector3) -> GripperBox:
    """Return the box between two opposite corners."""
    low, high = zip(*((min(pair), max(pair)) for pair in zip(one, other, strict=True)), strict=True)
    return GripperBox(low, high)
