"""`pointchain demo`: the main job once, with no hardware, and a judgement by the known truth."""

import json
import shutil
import sys
import threading
from contextlib import closing
from pathlib import Path

from cell.arm_settings import SimulatedArm
from cell.cell import Cell
from cell.recording import read_recording
from cell.settings import CellSettings
from cell.simulation.scoring import score
from cell.simulation.simulate import truth_path
from cell.simulation.world import simulated_world, world_truth
from recognition.model import PointChainModel
from service.data_folder import PREVIEW
from service.scan_once import Wanted, take_scan
from service.trace import write_trace
from service.worker import RecognitionWorker
from service.workflow import recognise_recording, write_preview, write_results

TIME_FACTOR = 4.0
"""The simulated arm moves so many times as fast as a real one: nobody waits half a minute for a demonstration."""


def demo(folder: Path) -> int:
    """Scans with the simulated cell, recognises what it saw, and says on stdout what came out and where it lies.

    `folder` holds the results; what an earlier demo left there is replaced. 0 when the model has the true
    topology, else 1.
    """
    made = [folder / name for name in ("scan.mcap", "scan.truth.json", "result", "trace")]
    if folder.exists() and {path.name for path in folder.iterdir()} - {path.name for path in made}:
        print(f"pointchain demo: {folder} holds other files; name another folder", file=sys.stderr)
        return 1
    for path in made:
        shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
    folder.mkdir(parents=True, exist_ok=True)
    recording, _, results, trace = made

    settings = CellSettings(arm=SimulatedArm(time_factor=TIME_FACTOR))
    with closing(Cell(settings)) as cell, closing(RecognitionWorker()) as worker:
        take_scan(cell, worker, Wanted(recording), _say, threading.Event())
        status = cell.status
    # The recording gives what the scan gave, and on the way there what is drawn.
    recognition = recognise_recording(recording)
    told = [view.T_base_flange for view in read_recording(recording).views]
    truth = world_truth(simulated_world(settings), told)
    truth_path(recording).write_text(json.dumps(truth))
    write_results(recognition, results)
    write_preview(recognition, results / PREVIEW)
    pictures = write_trace(recognition, trace, truth)
    model = recognition.model
    assert status.camera is not None
    print(f"Live scan          {len(told)} views by a simulated {settings.arm.model} and {status.camera.product}")
    for line in _told(model):
        print(line)
    judged = score(model.to_json(), truth)
    errors = "" if judged.mean_m is None else f", centre line {judged.mean_m * 1000:.2f} mm off on average"
    print(f"Against the truth  topology {'right' if judged.topology else 'WRONG'}{errors}")
    print(f"Recording          {recording}")
    print(f"Results            {', '.join(str(path) for path in sorted(results.iterdir()))}")
    print(f"Stage by stage     {len(pictures)} pictures in {trace}/")
    return 0 if judged.topology else 1


def _say(words: str) -> None:
    print(f"  {words}", flush=True)


def _told(model: PointChainModel) -> list[str]:
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
    lines += [f"Warning            {warning}" for warning in (*model.quality.ambiguities, *model.quality.warnings)]
    return lines
