"""The paper's parameters (Table I and sections II to III), all in metres."""

import math
from dataclasses import asdict, dataclass

from recognition.errors import InvalidParametersError

R_MIN = 0.0005
"""Smallest string radius taken, metres: below it a depth camera sees noise."""
R_MAX = 0.02
"""Largest string radius taken, metres: above it the views no longer hold string and table."""


@dataclass(frozen=True)
class ChainParameters:
    """Radii and thresholds of the method. `for_radius` gives the paper's values at r = 4.2 mm.

    Raises InvalidParametersError when a condition of Table I is broken.
    """

    r: float
    """String radius."""
    z_t: float
    """Height above the table under which points are removed (II.B; 5 mm in the paper)."""
    r_c: float
    """Neighbourhood of thinning, eq. (3)."""
    r_s: float
    """Neighbourhood of the contribution rate, eqs. (4) to (6)."""
    rho_t: float
    """Points with a smaller contribution rate belong to an intersection (III.C)."""
    R_t: float
    """Rate of intersection points, eq. (7), from which on the search is inside an intersection. R_t < 1."""
    r_n: float
    """Inner search sphere of the matching method: about the distance of chain points. 0 < r_n."""
    r_f: float
    """Outer search sphere of the matching method. r_n < r_f."""
    r_cn: float
    """Inner sphere of the bifurcated restart: the intersection's extent. r_n + r_f <= r_cn."""
    r_cf: float
    """Outer sphere of the bifurcated restart. r_cn < r_cf < r_cn + r_n."""

    def __post_init__(self) -> None:
        values = asdict(self)
        for name, value in values.items():
            if not (isinstance(value, float | int) and math.isfinite(value)):
                raise InvalidParametersError(f"{name} is {value!r}; a finite number is needed")
        if self.r <= 0:
            raise InvalidParametersError(f"the string radius is {self.r:g} m; it must be positive")
        if not R_MIN <= self.r <= R_MAX:
            raise InvalidParametersError(
                f"the string radius is {self.r:g} m; radii from {R_MIN:g} to {R_MAX:g} m are taken (metres, not mm)"
            )
        conditions = {
            "0 < z_t < 2 r": 0 < self.z_t < 2 * self.r,
            "0 < r_c": self.r_c > 0,
            "0 < r_s": self.r_s > 0,
            "1/3 < rho_t < 1": 1 / 3 < self.rho_t < 1,
            "0 < R_t < 1": 0 < self.R_t < 1,
            "0 < r_n": self.r_n > 0,
            "r_n < r_f": self.r_n < self.r_f,
            # Table I's own values meet this one with equality, so rounding must not break it.
            "r_n + r_f <= r_cn": self.r_n + self.r_f <= self.r_cn * (1 + 1e-9),
            "r_cn < r_cf < r_cn + r_n": self.r_cn < self.r_cf < self.r_cn + self.r_n,
        }
        broken = [condition for condition, holds in conditions.items() if not holds]
        if broken:
            raise InvalidParametersError(f"the parameters break {', '.join(broken)} (Table I); they are {values}")

    @classmethod
    def for_radius(cls, r: float) -> "ChainParameters":
        """The parameters for a string of radius `r`, in the ratios of Table I (exactly Table I at 4.2 mm)."""
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
