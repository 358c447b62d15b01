"""Recognition of knots that are pulled tight, with the truth of the simulation."""

import pytest

from cell.simulation.cases import make_case, simulate
from cell.simulation.evaluation.metrics import Score, score
from recognition.model.model import PointChainModel
from recognition.parameters import ChainParameters
from recognition.pipeline import recognise
from recognition.preprocessing import Scene

pytestmark = pytest.mark.slow


def recognised(seed: int) -> tuple[PointChainModel, Score]:
    """Recognise a case of the tier `tight` and score the model."""
    case = make_case("tight", seed)
    scan = simulate(case)
    scene = Scene(scan.header.table_z_m, scan.header.workspace_m)
    model = recognise(scan.views, ChainParameters.for_radius(case.scene.radius_m), scene).model
    return model, score(model.to_json(), scan.truth)


@pytest.mark.parametrize(("seed", "crossings"), [(4, 4), (12, 3)])
def test_a_tight_knot_is_one_string_with_its_crossings(seed: int, crossings: int) -> None:
    _, result = recognised(seed)
    assert (result.chains, result.crossings) == (1, crossings)
    assert result.topology
    assert result.cover > 0.95


def test_a_square_knot_with_exchangeable_ends_is_uncertain() -> None:
    model, _ = recognised(5)
    assert "connection-uncertain" in {found.code for found in model.quality.findings}
