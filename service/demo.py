"""`pointchain demo`: the main job once with no hardware, told for people."""

import shutil
import sys
from pathlib import Path

from cell.recording import read_recording
from cell.simulation.camera import camera_model
from cell.simulation.scenes import make_scene
from cell.simulation.scoring import score
from cell.simulation.simulate import simulate, write_simulation
from recognition.model import PointChainModel
from service.trace import write_trace
from service.workflow import recognise_recording, write_results

SCENE, CAMERA, SEED = "figure-eight", "oak-d-sr", 3


def demo(folder: Path) -> int:
    """Simulates a scan, recognises the recording, and says on stdout what came out and where it lies.

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

    scan = simulate(make_scene(SCENE, SEED), camera_model(CAMERA), SEED)
    write_simulation(scan, recording)
    views = len(read_recording(recording).views)
    print(f"Simulated scan     {views} views of a {SCENE} string by an {CAMERA} camera")
    recognition = recognise_recording(recording)
    write_results(recognition, results)
    pictures = write_trace(recognition, trace, scan.truth)
    model = recognition.model
    for line in _told(model):
        print(line)
    judged = score(model.to_json(), scan.truth)
    errors = "" if judged.mean_m is None else f", centre line {judged.mean_m * 1000:.2f} mm off on average"
    print(f"Against the truth  topology {'right' if judged.topology else 'WRONG'}{errors}")
    print(f"Recording          {recording}")
    print(f"Results            {', '.join(str(path) for path in sorted(results.iterdir()))}")
    print(f"Stage by stage     {len(pictures)} pictures in {trace}/")
    return 0 if judged.topology else 1


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
