"""Recognition of knots that are pulled tight, with the truth of the simulation."""

import pytest

from cell.simulation.cases import make_case, simulate
from cell.simulation.evaluation.metrics import score
from recognition.pipeline import recognise
from recognition.preprocessing import Scene
from recognition.request import RecognitionRequest

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(("seed", "strings", "crossings"), [(3, 1, 3), (4, 1, 4), (5, 2, 6)])
def test_a_tight_knot_has_its_strings_and_crossings(seed: int, strings: int, crossings: int) -> None:
    case = make_case("tight", seed, "ideal")
    scan = simulate(case)
    scene = Scene(scan.header.table_z_m, scan.header.workspace_m)
    model = recognise(scan.views, RecognitionRequest(radius_m=case.scene.radius_m), scene).model.to_json()
    found = score(model, scan.truth)
    assert (found.chains, found.crossings) == (strings, crossings)
    assert found.topology
    assert found.cover > 0.95
    assert found.confident_mistakes == 0
