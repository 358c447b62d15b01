"""A single view of a stereo camera, whose heights are uneven: models of it are not accepted if they are wrong."""

import pytest

from cell.simulation.evaluation.metrics import score
from cell.simulation.offline_scan import simulate
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.scenes import make_scene
from recognition.pipeline import recognise
from recognition.preprocessing.target_cloud import Scene
from recognition.request import RecognitionRequest


@pytest.mark.parametrize(
    ("name", "seed"),
    [
        ("side-by-side", 137),  # two strings in sight were excluded as not round, and the empty model was accepted
        ("overhand-knot", 23),  # one string in two chains, whose ends were free
    ],
)
def test_a_wrong_model_of_a_single_view_has_a_doubt(name: str, seed: int) -> None:
    scene = make_scene(name, seed)
    scan = simulate(scene, camera_model("oak-d-pro"), seed, views=1)
    request = RecognitionRequest(radius_m=scene.radius_m)
    model = recognise(scan.views, request, Scene(workspace_m=scan.header.workspace_m)).model
    is_right = score(model.to_json(), scan.truth).topology
    assert is_right or model.quality.verdict == "review"
