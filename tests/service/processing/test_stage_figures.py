"""The pictures of the stages: their names, and no text is cut off or covered."""

import json
from collections.abc import Iterator
from itertools import combinations
from pathlib import Path
from typing import Any

import pytest

from cell.simulation.offline_scan import simulate
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.scenes import make_scene
from recognition.model.model import METHODS, Method
from recognition.pipeline import recognise
from recognition.preprocessing.target_cloud import Scene
from recognition.request import RecognitionRequest
from recognition.result import Recognition
from service.processing.stage_figures import STAGE_PICTURES, stage_figures, write_trace

COMMON = ("target_cloud", "registered_cloud", "centre_line")
NAMES = {
    "graph": (*COMMON, "nodes", "fragments", "paired_ends", "tube_fit", "model"),
    "enhanced": (*COMMON, "thinned_cloud", "contribution_rate", "intersections", "segments", "reconnected", "model"),
    "matching": (*COMMON, "segments", "model"),
}


@pytest.fixture(scope="module", params=["figure-eight", "coil"])
def scan(request: pytest.FixtureRequest) -> Any:
    """Return a scan with one crossing, and a scan with several."""
    crossings = 3 if request.param == "coil" else None
    return simulate(make_scene(request.param, 1, crossings=crossings), camera_model("exact", (320, 200)), 1, views=4)


def recognise_scan(scan: Any, method: Method) -> Recognition:
    scene = Scene(scan.header.table_z_m, scan.header.workspace_m)
    return recognise(scan.views, RecognitionRequest(method=method, radius_m=scan.truth["radius"]), scene)


@pytest.mark.parametrize("method", METHODS)
def test_every_text_of_every_picture_is_readable(scan: Any, method: Method) -> None:
    names = []
    for name, figure in stage_figures(recognise_scan(scan, method), scan.truth):
        names.append(name)
        figure.canvas.draw()
        boxes = [(text, axes, text.get_window_extent()) for text, axes in visible_texts(figure)]
        assert len(boxes) > 5
        for text, axes, box in boxes:
            shown = f"{method}, {name}: {text.get_text()!r} at {box}"
            assert 0 <= box.x0 <= box.x1 <= figure.bbox.width, f"{shown} is cut off"
            assert 0 <= box.y0 <= box.y1 <= figure.bbox.height, f"{shown} is cut off"
            for others in set(figure.axes) - {axes}:
                assert not box.overlaps(others.bbox), f"{shown} overlaps other axes"
        for (one, _, box), (other, _, other_box) in combinations(boxes, 2):
            assert not box.overlaps(other_box), f"{method}, {name}: {one.get_text()!r} overlaps {other.get_text()!r}"
    assert tuple(names) == NAMES[method]


def visible_texts(figure: Any) -> Iterator[tuple[Any, Any]]:
    """Yield each text that is drawn, and the axes that it belongs to (None for a legend or a title of the figure)."""
    from matplotlib.text import Text

    axes_of = {}
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis, getattr(axes, "zaxis", None)):
            if axis is None:
                continue
            axes_of[axis.label] = axes
            low, high = sorted(axis.get_view_interval())
            for tick in (*axis.get_major_ticks(), *axis.get_minor_ticks()):
                # Ticks outside the limits of their axis exist, and are not drawn.
                drawn = axes if low <= tick.get_loc() <= high else None
                axes_of |= {tick.label1: drawn, tick.label2: drawn}
    for text in figure.findobj(Text):
        axes = axes_of.get(text, text.axes)
        is_hidden_tick = text in axes_of and axes is None
        if text.get_visible() and text.get_text().strip() and not is_hidden_tick:
            yield text, axes


def test_the_close_up_has_the_labels_of_the_strands_inside_its_frame() -> None:
    scan = simulate(make_scene("figure-eight", 1), camera_model("exact", (320, 200)), 1, views=4)
    model = recognise_scan(scan, "graph")
    assert len(model.model.crossings) == 1
    *_, (name, figure) = stage_figures(model, scan.truth)
    assert name == "model"
    figure.canvas.draw()
    close_up = figure.axes[-1]
    labels = {text.get_text(): text for text in close_up.texts}
    assert set(labels) == {"over", "under"}
    for text in labels.values():
        box = text.get_window_extent()
        assert close_up.bbox.x0 <= box.x0 <= box.x1 <= close_up.bbox.x1
        assert close_up.bbox.y0 <= box.y0 <= box.y1 <= close_up.bbox.y1


@pytest.mark.parametrize("scan", ["figure-eight"], indirect=True)
def test_pictures_are_numbered_and_replace_those_of_another_method(scan: Any, tmp_path: Path) -> None:
    (tmp_path / "01_notes.png").write_text("not ours")
    for method in METHODS:
        written = write_trace(recognise_scan(scan, method), tmp_path, json.loads(json.dumps(scan.truth)))
        assert [path.name for path in written] == [f"{k:02}_{name}.png" for k, name in enumerate(NAMES[method], 1)]
        assert sorted(tmp_path.iterdir()) == sorted([*written, tmp_path / "01_notes.png"])
        assert all(path.read_bytes().startswith(b"\x89PNG") for path in written)
    assert set(STAGE_PICTURES) == {name for names in NAMES.values() for name in names}


def test_a_scan_without_a_string_has_the_pictures_that_were_reached(tmp_path: Path) -> None:
    scan = simulate(make_scene("arc", 1), camera_model("exact", (320, 200)), 1, views=4)
    beside = Scene(scan.header.table_z_m, ((-0.2, -0.12), (-0.2, -0.12), (0.0, 0.1)))
    recognition = recognise(scan.views, RecognitionRequest(radius_m=scan.truth["radius"]), beside)
    assert recognition.model.chains == ()
    assert [path.name for path in write_trace(recognition, tmp_path)] == ["01_target_cloud.png", "02_model.png"]
