"""`pointchain bench` on the command line: stdout, stderr and the exit code."""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from cell.config.camera_names import CameraName
from cell.simulation.benchmark.grasps import GraspCase, GraspResult
from cell.simulation.benchmark.scaling import Growth, make_rows
from cell.simulation.benchmark.speed import Speed, Timing
from cell.simulation.evaluation.metrics import Score
from cell.simulation.offline_scan import SimulatedScan, simulate
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.scenes import make_scene
from recognition.model.model import METHODS
from service.benchmark.estimate import Probe
from service.benchmark.service import Answers, ServiceTimes
from service.benchmark.service_process import MeasurementError
from service.benchmark.views import VIEWS_TIERS, ViewsCase, ViewsResult
from service.cli.main import main

SERIES = make_rows([1.0, 2.0], [Timing(0.2, {}, 100), Timing(0.3, {}, 200)])


@pytest.fixture(autouse=True)
def probed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Replace the probe, which takes seconds, by a machine that needs one second for it."""
    monkeypatch.setattr(
        "service.benchmark.command.measure_probe", lambda processes, camera: Probe(start_s=4.0, case_s=1.0)
    )


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> SimulatedScan:
    """Replace the scans of the tiers by a small one, and recognise it in this process."""
    scan = simulate(make_scene("arc", 1), camera_model("exact", (320, 200)), 1, views=4)
    monkeypatch.setattr("cell.simulation.cases.simulate", lambda case: scan)
    monkeypatch.setattr("cell.simulation.benchmark.accuracy.map_in_processes", lambda work, items, _: map(work, items))
    return scan


@pytest.fixture
def measured(monkeypatch: pytest.MonkeyPatch) -> None:
    """Replace the measurements, which take a minute, by fixed results."""
    monkeypatch.setattr(
        "service.benchmark.command.measure_speed",
        lambda report, camera: Speed(0.25, 5.0, 20.0, 0.1, 0.75, 80.0, {"preprocess": 0.05}),
    )
    monkeypatch.setattr(
        "service.benchmark.command.measure_growth", lambda report, camera: Growth(SERIES, SERIES, SERIES)
    )


@pytest.mark.usefixtures("small")
def test_accuracy_is_one_document_of_every_tier_and_method(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["bench", "--only", "accuracy", "--tiers", "paper, soft", "--seeds", "1", "--jobs", "2", "--json"]
    assert main(arguments) == 0
    out, err = capsys.readouterr()
    document = json.loads(out)
    assert "2 scenes by " in err
    assert "tier paper is done (about " in err
    assert "tier soft is done (about 0 s left)" in err
    assert set(document) == {"machine", "camera", "accuracy", "sigma", "findings", "grasps", "cases"}
    assert set(document["accuracy"]) == {"paper", "soft"}
    assert set(document["grasps"]) == {"paper", "soft"}
    assert document["grasps"]["paper"]["grasps"] > 0
    assert [(case["tier"], case["seed"]) for case in document["cases"][:: len(METHODS)]] == [("paper", 0), ("soft", 0)]
    for method in METHODS:
        summary = document["accuracy"]["paper"][method]
        assert {"n", "topology", "mean_mm", "shape_mm", "end_mm", "cover", "p95_mm"} <= set(summary)
        assert summary["n"] == 1
        low, high = summary["topology_interval_95"]
        assert 0.0 <= low <= summary["topology"] <= high <= 1.0
        low, high = document["sigma"]["all"][method]["within_2_sigma_interval_95"]
        assert 0.0 <= low <= document["sigma"]["all"][method]["within_2_sigma"] <= high <= 1.0
        # the given poses have errors of half a millimetre
        assert 0.05 < summary["mean_mm"] < 2.0
        assert summary["cover"] > 0.9
        counts = document["findings"]["paper"][method]
        assert sum(counts["right"].values()) + sum(counts["wrong"].values()) == 1
        assert document["sigma"]["paper"][method] == document["sigma"]["soft"][method]
        assert document["sigma"]["all"][method]["n_points"] == 2 * document["sigma"]["paper"][method]["n_points"] > 50


@pytest.mark.usefixtures("small")
def test_each_tier_is_printed_when_it_ends(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    printed = []

    def watched(work: Any, items: Any, jobs: int) -> Any:
        for item in items:
            printed.append((item, capsys.readouterr().out))
            yield work(item)

    monkeypatch.setattr("cell.simulation.benchmark.accuracy.map_in_processes", watched)
    assert main(["bench", "--only", "accuracy", "--tiers", "paper,soft,hard", "--seeds", "2", "--jobs", "1"]) == 0
    items, outputs = [item for item, _ in printed], [out for _, out in printed]
    assert items == [(tier, seed) for tier in ("paper", "soft", "hard") for seed in range(2)]
    assert outputs[0].startswith("| tier | method | scenes | topology right | 95 % interval | ")
    assert outputs[0].splitlines()[1].startswith("| --- |")
    # the rows of a tier are printed before the next tier begins
    assert (outputs[1], outputs[3], outputs[5]) == ("", "", "")
    for tier, out in (("paper", outputs[2]), ("soft", outputs[4])):
        rows = [line.split(" | ") for line in out.splitlines()]
        assert [(row[0], row[1], row[2]) for row in rows] == [(f"| {tier}", method, "2") for method in METHODS]
        assert all(re.fullmatch(r"[0-9.]+% to [0-9.]+%", row[4]) for row in rows)
    rest = capsys.readouterr().out
    assert rest.startswith("| hard | ")
    assert "\n\n| tier | method | within 2 sigma | 95 % interval | points | " in rest


@pytest.mark.usefixtures("measured")
def test_speed_is_one_document(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "--only", "speed", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert set(document) == {"machine", "camera", "speed", "stages", "growth"}
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
def test_speed_is_printed_as_tables(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "--only", "speed"]) == 0
    out, err = capsys.readouterr()
    assert "| 640x400 | 0.250 s |" in out
    assert out.index("| 8 views to the model |") < out.index("| stage, 640x400 |") < out.index("| input |")
    assert "this takes about " in err
    assert "speed, memory and growth" in err


@pytest.mark.usefixtures("measured")
def test_a_part_is_printed_when_it_ends(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def measure_growth(report: Callable[[str], None], camera: CameraName) -> Growth:
        assert "| 640x400 | 0.250 s |" in capsys.readouterr().out, "the speed was printed before growth is measured"
        report("growth")
        return Growth(SERIES, SERIES, SERIES)

    monkeypatch.setattr("service.benchmark.command.measure_growth", measure_growth)
    assert main(["bench", "--only", "speed"]) == 0
    out, err = capsys.readouterr()
    assert out.startswith("| input |")
    assert re.search(r"^pointchain bench: growth \(about \d+ (s|min) left\)$", err, re.MULTILINE)


@pytest.fixture
def grasped(monkeypatch: pytest.MonkeyPatch) -> None:
    """Replace the simulation of grasps, which takes half a minute a scene, by fixed results."""

    def run(tier_and_seed: tuple[str, int]) -> GraspCase:
        tier, seed = tier_and_seed
        if tier == "measured":
            return GraspCase(tier, seed, "contradicting-views: the views contradict each other")
        best = GraspResult(0, True, True, False, False, ("down",) if seed else (), False, bool(seed))
        second = GraspResult(1, False, seed == 0, seed == 1, True, None, None, None)
        return GraspCase(tier, seed, None, (best, second))

    monkeypatch.setattr("cell.simulation.benchmark.grasps.map_in_processes", lambda _, items, jobs: map(run, items))


@pytest.mark.usefixtures("grasped")
def test_grasps_are_printed_by_tier_and_selection(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "--only", "grasps", "--tiers", "paper,measured", "--seeds", "2"]) == 0
    out, err = capsys.readouterr()
    head, _, *lines = out.splitlines()
    rows = [dict(zip(head.split(" | ")[:11], line.split(" | "), strict=False)) for line in lines]
    assert [row["grasps"] for row in rows] == 2 * ["best", "top 5", "all"]
    best, every, refused = rows[0], rows[2], rows[3]
    assert (best["simulated"], best["right string lifted"], best["with robot errors"]) == ("2", "100.0%", "2")
    assert lines[0].endswith("| 2 | 50.0% | 0.0% | 50.0% |")
    assert (every["simulated"], every["right string lifted"], every["wrong string"]) == ("4", "75.0%", "25.0%")
    assert (every["touching"], every["clean by geometry"]) == ("50.0%", "50.0%")
    assert (refused["scenes"], refused["without grasp"], refused["right string lifted"]) == ("0", "2", "-")
    assert "simulated grasps in 4 scenes" in err
    assert "grasps: tier measured is done (about 0 s left)" in err


@pytest.fixture
def viewed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Replace the comparison of views, which takes seconds a scene, by fixed results. Odd scenes are outside."""
    score = Score("arc", 1, 1, 2, 0, 0, 0.0002, 0.0004, 0.0001, 0.0006, 1.0, True, 0)

    def run(tier_and_seed: tuple[str, int]) -> ViewsCase | None:
        tier, seed = tier_and_seed
        result = ViewsResult(score, "accept")
        return None if seed % 2 else ViewsCase(tier, seed, 4 + seed, result, result)

    monkeypatch.setattr("service.benchmark.views.map_in_processes", lambda _, items, jobs: map(run, items))


@pytest.mark.usefixtures("viewed")
def test_views_are_printed_by_tier(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "--only", "views", "--tiers", "paper,soft", "--seeds", "3"]) == 0
    out, err = capsys.readouterr()
    head, _, *lines = out.splitlines()
    assert head.startswith("| tier | scenes | four views enough |")
    figures = "2 | 50% | 5.0 | 2 | 2 | 0 | 0 | 0.20 mm | 0.20 mm | 0.60 mm | 0.60 mm |"
    assert lines == [f"| paper | {figures}", f"| soft | {figures}"]
    assert "views as needed and eight views on 6 scenes" in err
    assert "views: tier soft is done (about 0 s left)" in err


@pytest.mark.usefixtures("viewed")
def test_views_are_one_document_of_all_tiers_that_the_cell_can_have(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "--only", "views", "--seeds", "2", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert set(document) == {"machine", "camera", "views", "views_cases"}
    assert set(document["views"]) == set(VIEWS_TIERS)
    assert document["views"]["paper"]["auto_mean_mm"] == 0.2
    assert [case["seed"] for case in document["views_cases"]] == 8 * [0]
    assert main(["bench", "--only", "views", "--tiers", "measured"]) == 1
    assert "there is no tier 'measured' in the part views" in capsys.readouterr().err


@pytest.mark.usefixtures("grasped")
def test_grasps_are_one_document(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "--only", "grasps", "--tiers", "paper", "--seeds", "1", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert set(document) == {"machine", "camera", "grasps", "grasp_cases"}
    assert document["grasps"]["paper"]["best"]["good"] == 1.0
    assert document["grasp_cases"][0]["grasps"][1]["touching"] is True


def test_the_service_part_is_printed(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
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
    monkeypatch.setattr("service.benchmark.command.measure_service", lambda report: times)
    assert main(["bench", "--only", "service", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert set(document) == {"machine", "camera", "service"}
    assert document["service"]["kinds"]["the cell"] == {"per_s": 1234.5, "p50_s": 0.00612, "p99_s": 0.0187}
    assert main(["bench", "--only", "service"]) == 0
    out = capsys.readouterr().out
    assert "| during a live scan | 1234 | 6.1 ms | 18.7 ms |" in out
    assert "| a live scan under load | 21.0 s, 1.05 times as long |" in out
    assert "| stop to the controller, 50 % and 99 % of 40 | 10 ms, 20 ms |" in out
    monkeypatch.setattr(
        "service.benchmark.command.measure_service", lambda report: replace(times, loaded_scan_s=None, failed_scans=2)
    )
    assert main(["bench", "--only", "service"]) == 0
    assert "| a live scan under load | none succeeded |" in capsys.readouterr().out


def test_a_failed_part_gives_its_reason(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(report: Callable[[str], None]) -> None:
        raise MeasurementError("the scan ended failed: the robot was lost")

    monkeypatch.setattr("service.benchmark.command.measure_cell", fail)
    assert main(["bench", "--only", "cell", "--json"]) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert "the cell part failed: the scan ended failed: the robot was lost; run it on a machine" in err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--seeds", "0"], "--seeds"),
        (["--jobs", "0"], "--jobs"),
        (["--tiers", "paper,easy"], "there is no tier 'easy'; known are paper"),
    ],
)
def test_wrong_arguments_are_reported(arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", *arguments]) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert message in err
