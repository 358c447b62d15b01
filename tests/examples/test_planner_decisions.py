"""The planner of the examples acts on right models, and on no wrong one."""

import importlib.util
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

from cell.simulation.evaluation.metrics import Score, score
from cell.simulation.offline_scan import simulate
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.scenes import make_scene
from recognition.model.chains import Grasp
from recognition.model.model import PointChainModel
from recognition.parameters import ChainParameters
from recognition.pipeline import recognise
from recognition.preprocessing import Scene


@pytest.fixture(scope="module")
def planner() -> ModuleType:
    path = Path(__file__).parents[2] / "examples/planner.py"
    spec = importlib.util.spec_from_file_location("planner", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_its_decisions_are_counted() -> None:
    """The models of seed 0 of all scenes are right and without a doubt."""
    root = Path(__file__).parents[2]
    program = [sys.executable, str(root / "examples/planner_accuracy.py"), "--seeds", "1"]
    done = subprocess.run(program, cwd=root, capture_output=True, text=True, check=True)
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in done.stdout.splitlines()[2:]]
    assert [(row[0], row[1]) for row in rows] == [
        (name, boxes)
        for name in ("figure-eight", "tangle", "side-by-side", "end-on-strand", "empty")
        for boxes in ("0", "4")
    ]
    assert all(row[2:] == ["1", "1", "1", "0", "0"] for row in rows), rows


def scanned(name: str, seed: int, clutter: int, radius_share: float = 1.0) -> tuple[PointChainModel, Score]:
    """Return the model of a simulated scene and its score, for a given radius of `radius_share` of the true one."""
    scene = make_scene(name, seed, clutter=clutter)
    scan = simulate(scene, camera_model("oak-d-pro"), seed)
    parameters = ChainParameters.for_radius(radius_share * scene.radius_m)
    model = recognise(scan.views, parameters, Scene(workspace_m=scan.header.workspace_m)).model
    return model, score(model.to_json(), scan.truth)


@pytest.mark.parametrize("clutter", [0, 4])
@pytest.mark.parametrize("name", ["figure-eight", "tangle", "side-by-side", "end-on-strand"])
def test_it_grasps_a_string_of_a_right_model(planner: ModuleType, name: str, clutter: int) -> None:
    model, result = scanned(name, 3, clutter)
    assert result.topology
    grasp = planner.decide(model, may_rescan=True)
    assert isinstance(grasp, Grasp)
    assert grasp == model.grasps[0]


@pytest.mark.parametrize("clutter", [0, 4])
def test_it_does_nothing_where_no_string_is(planner: ModuleType, clutter: int) -> None:
    model, _ = scanned("empty", 3, clutter)
    assert planner.decide(model, may_rescan=True) == "done"


# In these scenes without a string, the edge or a fold of an object is recognised as a chain.
@pytest.mark.parametrize(("seed", "clutter"), [(11, 0), (177, 0), (10, 4), (121, 4)])
def test_it_asks_a_person_about_an_object_that_looks_like_a_string(
    planner: ModuleType, seed: int, clutter: int
) -> None:
    model, _ = scanned("empty", seed, clutter)
    assert model.chains
    assert planner.decide(model, may_rescan=True) == "ask"


def test_it_does_not_act_on_a_wrong_model_for_a_wrong_radius(planner: ModuleType) -> None:
    model, result = scanned("several", 1, 0, 1.5)
    assert not result.topology
    assert not isinstance(planner.decide(model, may_rescan=True), Grasp)
    assert planner.decide(model, may_rescan=False) == "ask"
