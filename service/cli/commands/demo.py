"""`pointchain demo`: scan a simulated string, recognise it, find a reachable grasp, and compare with the truth."""

import json
import shlex
import shutil
import sys
import threading
from collections import Counter
from collections.abc import Iterable, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell.config.arm_config import SimulatedArm
from cell.config.camera_config import SimulatedCamera
from cell.config.camera_names import DEFAULT_CAMERA, CameraName
from cell.config.cell_config import CellSettings
from cell.control.cell import Cell
from cell.errors import CellError
from cell.planning.grasp_reach import GraspReach
from cell.recording import read_recording
from cell.simulation.devices.world import simulated_world, world_truth
from cell.simulation.evaluation.metrics import score
from cell.simulation.offline_scan import truth_path
from recognition.model.grasps import Grasp
from recognition.model.model import PointChainModel
from recognition.request import RecognitionRequest
from service.cli.commands.scan import ScanOptions, take_scan
from service.processing.reach_finder import ReachFinder
from service.processing.results import recognise_recording, write_preview, write_results
from service.processing.stage_figures import write_trace
from service.processing.worker import RecognitionWorker, TaskFailedError
from service.storage.data_folder import MODEL, PREVIEW

TIME_FACTOR = 4.0
"""Speed of the simulated arm relative to a real arm. A scan at real speed takes about 20 seconds."""
MAKEFILE = Path(__file__).resolve().parents[3] / "Makefile"
"""Exists in a source checkout, and not beside an installed package."""


def demo(folder: Path, camera: CameraName = DEFAULT_CAMERA) -> int:
    """Scan with the simulated cell, recognise the recording, and print the result and the next steps.

    Args:
        folder: Where the recording, the results and the pictures go. The files of an earlier demo are replaced.
        camera: Simulated camera.

    Returns:
        The exit code: 0 when the model has the true topology; 1 when it has not, or when the scan failed.
    """
    files = [folder / name for name in ("scan.mcap", "scan.truth.json", "result", "trace")]
    if folder.exists() and {path.name for path in folder.iterdir()} - {path.name for path in files}:
        print(f"pointchain demo: {folder} contains other files; give another folder", file=sys.stderr)
        return 1
    for path in files:
        shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
    folder.mkdir(parents=True, exist_ok=True)
    recording, _, results, trace = files

    simulated = SimulatedCamera(model=camera)
    settings = CellSettings(arm=SimulatedArm(time_factor=TIME_FACTOR), camera=simulated)
    request = RecognitionRequest(radius_m=simulated.string_radius_m)
    try:
        with closing(Cell(settings)) as cell, closing(RecognitionWorker()) as worker:
            take_scan(cell, worker, ScanOptions(recording, request), _report, threading.Event())
            status = cell.status
    except (CellError, TaskFailedError) as error:
        # the simulated cell has no faults, but a machine that is too busy exceeds the timeouts
        print(f"pointchain demo: the scan failed: {error}; try again when the machine is less busy", file=sys.stderr)
        return 1
    # The scan returns the model only. Recognition of the recording gives the same model and what the pictures need.
    recognition = recognise_recording(recording)
    poses = [view.T_base_flange for view in read_recording(recording).views]
    world = simulated_world(settings)
    truth = world_truth(world, poses)
    truth_path(recording).write_text(json.dumps(truth))
    outcome = write_results(recognition, results)
    model = recognition.model
    (results / MODEL).write_text(indented(outcome.model) + "\n")
    write_preview(recognition, results / PREVIEW)
    pictures = write_trace(recognition, trace, truth)
    assert status.camera is not None
    devices = f"a simulated {settings.arm.model} and a {status.camera.product} camera"
    print(f"Live scan          {len(poses)} views by {devices}")
    for line in _summary(model):
        print(line)
    heights = None
    if recognition.height_map is not None and recognition.grasping is not None:
        heights = recognition.height_map, recognition.grasping.floor.table_z_m
    gripper = settings.gripper.to_gripper()
    found = ReachFinder(settings).find("demo", model.grasps, gripper, world.nominal_hand_eye, heights)
    for line in describe_best_grasp(found):
        print(line)
    scores = score(model.to_json(), truth)
    error = "" if scores.mean_m is None else f", mean error of the centre line {scores.mean_m * 1000:.2f} mm"
    print(f"Against the truth  topology {'right' if scores.topology else 'WRONG'}{error}")
    print(f"Recording          {recording}")
    print(f"Results            {', '.join(str(path) for path in sorted(results.iterdir()))}")
    print(f"Stage by stage     {len(pictures)} pictures in {trace}/, from {pictures[0].name} to {pictures[-1].name}")
    for line in _next_steps(recording):
        print(line)
    return 0 if scores.topology else 1


def indented(value: Any, indent: str = "") -> str:
    """Return JSON text that a person can read: indented, with each list of plain values on one line."""
    deeper = indent + "  "
    if isinstance(value, dict) and value:
        members = [f"{deeper}{json.dumps(key)}: {indented(member, deeper)}" for key, member in value.items()]
        return "{\n" + ",\n".join(members) + f"\n{indent}}}"
    if isinstance(value, Sequence) and any(isinstance(item, dict | list | tuple) for item in value):
        return "[\n" + ",\n".join(deeper + indented(item, deeper) for item in value) + f"\n{indent}]"
    return json.dumps(value, allow_nan=False)


def describe_best_grasp(found: Iterable[tuple[Grasp, GraspReach]]) -> list[str]:
    """Return the lines about the first grasp that the arm can carry out, or about why there is none.

    Args:
        found: Grasps of a model with their reach, the best first. They are taken up to the first reachable one.
    """
    reasons: Counter[str | None] = Counter()
    for grasp, reach in found:
        if reach.q_pregrasp_rad is not None and reach.q_grasp_rad is not None:
            return _describe_grasp(grasp, reach.q_pregrasp_rad, reach.q_grasp_rad)
        reasons[reach.message] += 1
    if not reasons:
        return ["Best grasp         none: the model has no grasps"]
    shown = "; ".join(f"{message} ({count} of {reasons.total()})" for message, count in reasons.most_common())
    return [f"Best grasp         none that the arm can reach: {shown}"]


def _describe_grasp(grasp: Grasp, q_pregrasp_rad: NDArray[np.float64], q_grasp_rad: NDArray[np.float64]) -> list[str]:
    motion = grasp.T_base_flange
    poses = {"pre-grasp": motion.pregrasp, "grasp": motion.grasp, "retreat": motion.retreat}
    flange = ", ".join(f"{name} {_numbers(T[:3, 3] * 1000, 1)}" for name, T in poses.items())
    return [
        f"Best grasp         grasp {grasp.id}: chain {grasp.chain} at {grasp.s_m * 1000:.0f} mm, position "
        f"{_numbers(grasp.T_base_grasp[:3, 3] * 1000, 1)} mm, open to {grasp.opening_m * 1000:.1f} mm",
        f"Flange at          {flange} mm",
        f"Joints, pre-grasp  {_numbers(q_pregrasp_rad, 4)} rad",
        f"Joints, grasp      {_numbers(q_grasp_rad, 4)} rad",
    ]


def _numbers(values: NDArray[np.float64], digits: int) -> str:
    return f"[{', '.join(f'{value:.{digits}f}' for value in values.tolist())}]"


def _report(message: str) -> None:
    print(f"  {message}", flush=True)


def _summary(model: PointChainModel) -> list[str]:
    lines = [f"Recognised in      {sum(model.timing_s.values()):.1f} s"]
    for chain in model.chains:
        lines.append(
            f"Chain {chain.id}            {chain.length_m * 1000:.0f} mm, {len(chain.points)} points, "
            f"ends {' and '.join(chain.ends)}"
        )
    for crossing in model.crossings:
        lines.append(
            f"Crossing {crossing.id}         chain {crossing.over.chain} at {crossing.over.s_m * 1000:.0f} mm over "
            f"chain {crossing.under.chain} at {crossing.under.s_m * 1000:.0f} mm, "
            f"{crossing.gap_m * 1000:.1f} mm apart (confidence {crossing.confidence:.2f})"
        )
    lines.append(f"Verdict            {model.quality.verdict}")
    lines += [f"{found.severity.capitalize():19}{found.message}" for found in model.quality.findings]
    return lines


def _next_steps(recording: Path) -> list[str]:
    # A checkout has the command in .venv, which need not be on the PATH, and builds the console on `make serve`.
    command = "pointchain" if shutil.which("pointchain") else shlex.quote(sys.argv[0])
    serve = "make serve" if MAKEFILE.exists() else f"{command} serve"
    return [
        "",
        "Next steps",
        f"Open the console   {serve}, then open http://127.0.0.1:8000 in a browser",
        "Read the manual    http://127.0.0.1:8000/manual, while the service runs",
        f"Recognise again    {command} recognise {shlex.quote(str(recording))}",
    ]
