"""Surface that is as long, narrow and low as a string is a doubt if no strand follows it."""

import numpy as np
import pytest
from numpy.typing import NDArray

from recognition.assembly.unexplained import missed_string_findings
from recognition.parameters import ChainParameters

R = 0.004
PARAMETERS = ChainParameters.for_radius(R)
TABLE_Z_M = 0.1


def strip(length_m: float, half_width_m: float, height_m: float = 1.5 * R, bend: float = 0.0) -> NDArray[np.float64]:
    """Return the surface (N, 3) of a strip along x, bent into a parabola, at a height above the table."""
    x, y = np.meshgrid(np.arange(0, length_m, 0.001), np.arange(-half_width_m, half_width_m + 1e-9, 0.001))
    return np.column_stack([x.ravel(), (y + bend * x**2).ravel(), np.full(x.size, TABLE_Z_M + height_m)])


@pytest.mark.parametrize("bend", [0.0, 4.0])
@pytest.mark.parametrize("half_width_radii", [1.0, 1.5])
def test_a_narrow_strip_is_a_doubt(half_width_radii: float, bend: float) -> None:
    piece = strip(0.25, half_width_radii * R, bend=bend)
    (doubt,) = missed_string_findings([piece], [], [], PARAMETERS, TABLE_Z_M)
    assert (doubt.code, doubt.severity) == ("possible-string", "doubt")
    assert doubt.value == pytest.approx(np.linalg.norm(np.ptp(piece, axis=0)))
    assert "is as narrow and as low as a string and in no chain" in doubt.message


@pytest.mark.parametrize(
    "piece",
    [
        pytest.param(strip(0.06, R), id="short"),
        pytest.param(strip(0.25, 4 * R), id="wide"),
        pytest.param(strip(0.25, R, height_m=6 * R), id="high"),
    ],
)
def test_other_surface_is_none(piece: NDArray[np.float64]) -> None:
    assert missed_string_findings([piece], [], [], PARAMETERS, TABLE_Z_M) == []


def test_a_strip_that_was_a_strand_has_no_second_finding() -> None:
    piece = strip(0.25, R)
    line = np.linspace((0.0, 0.0, TABLE_Z_M + R), (0.25, 0.0, TABLE_Z_M + R), 60)
    assert missed_string_findings([piece], [line], [], PARAMETERS, TABLE_Z_M) == []
    assert len(missed_string_findings([piece], [line[:10]], [], PARAMETERS, TABLE_Z_M)) == 1
    assert missed_string_findings([piece], [], [line[30]], PARAMETERS, TABLE_Z_M) == []
    assert len(missed_string_findings([piece], [], [line[30] + (0, 0.05, 0)], PARAMETERS, TABLE_Z_M)) == 1
