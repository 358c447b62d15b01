"""The paper's parameters (Table I and sections II to III). Lengths are in metres."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace

from recognition.errors import InvalidParametersError

R_MIN = 0.0005
"""Smallest string radius accepted, metres. Below it, a depth camera measures only noise."""
R_MAX = 0.02
"""Largest string radius accepted, metres. Above it, the views no longer contain both the string and the table."""

USED_BY: Mapping[str, tuple[str, ...]] = {
    "z_t": ("graph", "enhanced", "matching"),
    "r_c": ("enhanced",),
    "r_s": ("enhanced",),
    "rho_t": ("enhanced",),
    "R_t": ("enhanced",),
    "r_n": ("graph", "enhanced", "matching"),
    "r_f": ("graph", "enhanced", "matching"),
    "r_cn": ("graph", "enhanced", "matching"),
    "r_cf": ("enhanced",),
}
"""Names of the methods that use each parameter. The radius `r`, which every method uses, is not listed."""


@dataclass(frozen=True)
class ChainParameters:
    """Radii and thresholds of the method. `for_radius(0.0042)` returns the values of the paper.

    Raises:
        InvalidParametersError: A value is not finite, the radius is not from `R_MIN` to `R_MAX`, or the values break a
            condition of Table I.

    Source:
        Table I, and sections II.B, II.G and III.B to III.D.
    """

    r: float
    """String radius."""
    z_t: float
    """Height threshold above the table; lower points are removed (II.B)."""
    r_c: float
    """Radius of the neighbourhood of thinning (III.B, eq. 3)."""
    r_s: float
    """Radius of the neighbourhood of the contribution rate (III.C, eqs. 4 to 6)."""
    rho_t: float
    """Threshold of the contribution rate; points with a smaller rate belong to an intersection (III.C)."""
    R_t: float
    """Threshold of the intersection ratio R_c (III.D, eq. 7); an intersection begins where R_c exceeds it."""
    r_n: float
    """Radius of the inner search sphere of the matching method (II.G), about the spacing of the chain points."""
    r_f: float
    """Radius of the outer search sphere of the matching method (II.G)."""
    r_cn: float
    """Radius of the inner sphere of the bifurcated restart (III.D), about the extent of an intersection."""
    r_cf: float
    """Radius of the outer sphere of the bifurcated restart (III.D)."""

    def __post_init__(self) -> None:
        values = asdict(self)
        for name, value in values.items():
            if not (isinstance(value, float | int) and math.isfinite(value)):
                raise InvalidParametersError(f"{name} is {value!r}; a finite number is needed")
        if self.r <= 0:
            raise InvalidParametersError(f"the string radius is {self.r:g} m; it must be positive")
        if not R_MIN <= self.r <= R_MAX:
            raise InvalidParametersError(
                f"the string radius is {self.r:g} m; it must be from {R_MIN:g} to {R_MAX:g} m (metres, not mm)"
            )
        conditions = {
            "0 < z_t < 2 r": 0 < self.z_t < 2 * self.r,
            "0 < r_c": self.r_c > 0,
            "0 < r_s": self.r_s > 0,
            "1/3 < rho_t < 1": 1 / 3 < self.rho_t < 1,
            "0 < R_t < 1": 0 < self.R_t < 1,
            "0 < r_n": self.r_n > 0,
            "r_n < r_f": self.r_n < self.r_f,
            # The values of Table I meet this condition with equality. Rounding must not break it.
            "r_n + r_f <= r_cn": self.r_n + self.r_f <= self.r_cn * (1 + 1e-9),
            "r_cn < r_cf < r_cn + r_n": self.r_cn < self.r_cf < self.r_cn + self.r_n,
        }
        broken = [condition for condition, holds in conditions.items() if not holds]
        if broken:
            raise InvalidParametersError(f"the parameters break {', '.join(broken)} (Table I); they are {values}")

    @classmethod
    def for_radius(cls, r: float) -> "ChainParameters":
        """Return the parameters for the string radius `r`, with the ratios of Table I.

        Args:
            r: String radius, metres, from 0.0005 to 0.02. 0.0042 gives the values of Table I.

        Raises:
            InvalidParametersError: The radius is not a number, or it is out of this range.
        """
        if not (isinstance(r, float | int) and math.isfinite(r)):
            raise InvalidParametersError(f"the string radius is {r!r}; a length in metres is needed")
        return cls(
            r=r,
            z_t=r * 5.0 / 4.2,
            r_c=r,
            r_s=r,
            rho_t=0.9,
            R_t=0.7,
            r_n=r,
            r_f=2 * r,
            r_cn=3 * r,
            r_cf=3.5 * r,
        )

    def with_settings(self, settings: Mapping[str, float]) -> "ChainParameters":
        """Return a copy of the parameters with the values of `settings`.

        Args:
            settings: Values by parameter name. The names are the keys of `USED_BY`. Lengths are in metres.

        Raises:
            InvalidParametersError: A name is unknown, a name is the radius, or the values break a condition of Table I.
        """
        check_names(settings)
        return replace(self, **settings) if settings else self


def check_names(names: Iterable[str]) -> None:
    """Check that each name is the name of a parameter other than the radius.

    Args:
        names: Names of parameters.

    Raises:
        InvalidParametersError: A name is unknown, or a name is the radius.
    """
    for name in names:
        if name == "r":
            raise InvalidParametersError(
                "r is the string radius and not a setting; give the radius, from which the other parameters follow"
            )
        if name not in USED_BY:
            raise InvalidParametersError(f"there is no parameter {name!r}; the parameters are {', '.join(USED_BY)}")


def check_settings(settings: Mapping[str, float], method: str) -> None:
    """Check that the method uses each parameter in `settings`.

    Args:
        settings: Values by parameter name.
        method: Name of the method, as in `USED_BY`.

    Raises:
        InvalidParametersError: A name is unknown, a name is the radius, or the method does not use a parameter.
    """
    check_names(settings)
    for name in settings:
        if method not in USED_BY[name]:
            raise InvalidParametersError(
                f"the method {method!r} does not use {name}, so it cannot be set; {name} is used by "
                f"{' and '.join(USED_BY[name])}"
            )
