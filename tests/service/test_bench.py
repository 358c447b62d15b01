"""`pointchain bench` as it is called: what is on stdout, on stderr, and the exit code."""

import json
from dataclasses import replace

import pytest

from cell.simulation.benchmark.growth import Growth, rows
from cell.simulation.benchmark.speed import Speed, Timing
from cell.simulation.camera import camera_model
from cell.simulation.scenes import make_scene
from cell.simulation.simulate import simulate
from recognition.model import METHODS
from service.bench_service import Answers, ServiceTimes
from service.cli import main

SERIES = rows([1.0, 2.0], [Timing(0.2, {}, 100), Timing(0.3, {}, 200)])


@pytest.fixture
def measured(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures in place of the measurements, which take a minute."""
    monkeypatch.setattr(
        "service.bench.measure_speed", lambda say: Speed(0.25, 5.0, 20.0, 0.1, 0.75, 80.0, {"preprocess": 0.05})
    )
    monkeypatch.setattr("service.bench.measure_growth", lambda say: Growth(SERIES, SERIES, SERIES))


def test_accuracy_is_one_document_of_every_tier_and_method(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    # A small scan in place of the tiers', and in this process: how work is shared out is tested by itself.
    scan = simulate(make_scene("arc", 1), camera_model("ideal", (320, 200)), 1, views=4)
    monkeypatch.setattr("cell.simulation.tiers.simulate", lambda case: scan)
    monkeypatch.setattr("cell.simulation.benchmark.accuracy.in_processes", lambda work, items, jobs: map(work, items))
    arguments = ["bench", "--only", "accuracy", "--tiers", "paper, soft", "--seeds", "1", "--jobs", "2", "--json"]
    assert main(arguments) == 0
    out, err = capsys.readouterr()
    document = json.loads(out)
    assert "2 scenes by " in err
    assert "soft done" in err
    assert set(document) == {"machine", "accuracy", "sigma", "cases"}
    assert set(document["accuracy"]) == {"paper", "soft"}
    assert [(case["tier"], case["seed"]) for case in document["cases"][:: len(METHODS)]] == [("paper", 0), ("soft", 0)]
    for method in METHODS:
        summary = document["accuracy"]["paper"][method]
        assert {"n", "topology", "mean_mm", "shape_mm", "end_mm", "cover", "p95_mm"} <= set(summary)
        assert summary["n"] == 1
        # Millimetres: the told poses are half a millimetre off.
        assert 0.05 < summary["mean_mm"] < 2.0
        assert summary["cover"] > 0.9
        assert document["sigma"]["paper"][method] == document["sigma"]["soft"][method]
        assert document["sigma"]["all"][method]["n_points"] == 2 * document["sigma"]["paper"][method]["n_points"] > 50


@pytest.mark.usefixtures("measured")
def test_speed_is_one_document(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "--only", "speed", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert set(document) == {"machine", "speed", "stages", "growth"}
    assert document["speed"] == {
        "views8_640x400_s": 0.25,
        "literal_s": 5.0,
        "ratio": 20.0,
        "after_last_view_s": 0.1,
        "views8_1280x800_s": 0.75,
        "peak_rss_mb": 80.0,
    }
    assert document["stages"] == {"preprocess": 0.05}
    assert document["growth"]["linear"] == {"points": True, "views": True, "length": True}
    assert [row["ratio"] for row in document["growth"]["length"]] == [1.0, pytest.approx(1.5)]


@pytest.mark.usefixtures("measured")
def test_people_get_tables(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "--only", "speed"]) == 0
    out, err = capsys.readouterr()
    assert "| 640x400 | 0.250 s |" in out
    assert "about 90 s" in err


def test_the_service_is_told_too(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    answers = Answers(1234.5, 0.00612345, 0.0187)
    times = ServiceTimes(
        idle=answers,
        scanning=answers,
        kinds={"the cell": answers},
        scan_s=20.0,
        loaded_scan_s=21.0,
        failed_scans=0,
        stopping=answers,
        streams_let_in=32,
        streams_refused=168,
        wrong=[],
        stops=40,
        wire_p50_s=0.01,
        wire_p99_s=0.02,
        answer_p50_s=0.03,
        answer_p99_s=0.04,
        still_p99_s=0.3,
    )
    monkeypatch.setattr("service.bench.measure_service", lambda say: times)
    assert main(["bench", "--only", "service", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert set(document) == {"machine", "service"}
    assert document["service"]["kinds"]["the cell"] == {"per_s": 1234.5, "p50_s": 0.00612, "p99_s": 0.0187}
    assert main(["bench", "--only", "service"]) == 0
    out = capsys.readouterr().out
    assert "| during a live scan | 1234 | 6.1 ms | 18.7 ms |" in out
    assert "| a live scan, under load | 21.0 s, 1.05 times as long |" in out
    assert "| stop to the controller, 50 % and 99 % of 40 | 10 ms, 20 ms |" in out
    monkeypatch.setattr("service.bench.measure_service", lambda say: replace(times, loaded_scan_s=None, failed_scans=2))
    assert main(["bench", "--only", "service"]) == 0
    assert "| a live scan, under load | none came to its end |" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--seeds", "0"], "--seeds"),
        (["--jobs", "0"], "--jobs"),
        (["--tiers", "paper,easy"], "there is no tier 'easy'; known are paper"),
    ],
)
def test_wrong_calls_are_told(arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", *arguments]) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert message in err
