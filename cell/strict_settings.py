"""What all settings have in common: a mistyped key or an impossible value is refused with its name."""

from pydantic import BaseModel, ConfigDict

Range = tuple[float, float]
Vector3 = tuple[float, float, float]
Vector6 = tuple[float, float, float, float, float, float]


class StrictSettings(BaseModel):
    """Numbers are finite, and nothing is taken that is not known."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
