"""Cases of thin strings."""

import numpy as np
import pytest

from cell.simulation.cases import make_case, simulate
from cell.simulation.cases.thin_tier import DISTANCE_M

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(("seed", "radius_m"), [(0, 0.001), (1, 0.0015)])
def test_thin_strings_are_seen_from_near(seed: int, radius_m: float) -> None:
    case = make_case("thin", seed, "ideal")
    assert case.scene.radii_m == (radius_m,)
    assert (case.camera.width, case.camera.height) == (1280, 800)
    for view in simulate(case).views:
        # The cameras look at the origin of the table. A string is up to 3 mm high, and a few pixels have no depth.
        middle = view.depth[380:420, 620:660]
        depth = np.median(middle[middle > 0]) * view.depth_unit_m
        assert DISTANCE_M[0] - 0.01 < depth < DISTANCE_M[1] + 0.01
