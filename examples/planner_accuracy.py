"""Count the decisions of `planner.py` about right and wrong models of simulated scenes.

    python examples/planner_accuracy.py --camera ideal --seeds 200

It prints a Markdown table. A model is right if its topology is right and it covers 95 % of the strings, or if it has no
chains where no string lies. No arm is simulated: each grasp counts as one that the arm can carry out. 200 seeds take
about 15 minutes on two cores with the camera `ideal`. The default camera renders images and matches their depth: 20
seeds take about 15 minutes.
"""

import argparse
import os
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from functools import partial

from planner import decide

from cell.config.camera_names import CAMERA_NAMES, DEFAULT_CAMERA, CameraName
from cell.simulation.benchmark.finding_counts import MIN_COVER
from cell.simulation.evaluation.metrics import score
from cell.simulation.offline_scan import simulate
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.scenes import make_scene
from pointchain_client import Model
from recognition.errors import RecognitionError
from recognition.parameters import ChainParameters
from recognition.pipeline import recognise
from recognition.preprocessing import Scene
from recognition.request import RecognitionRequest

SCENES = ("figure-eight", "tangle", "side-by-side", "end-on-strand", "empty")
BOXES = (0, 4)
COLUMNS = ("scene", "boxes", "right models", "of these without a doubt", "acts, or finds nothing to do", "wrong models",
           "acts on a wrong one", "refused")  # fmt: skip

Case = tuple[str, int, int]
"""Name of the scene, number of boxes, seed."""


def judge(case: Case, camera: CameraName) -> tuple[bool, str, bool] | None:
    """Return whether the model of a case is right, its verdict, and whether the planner acts or finds nothing to do.

    Returns None if recognition refuses the views.
    """
    name, boxes, seed = case
    scene = make_scene(name, seed, clutter=boxes)
    scan = simulate(scene, camera_model(camera), seed)
    parameters = ChainParameters.for_radius(scene.radius_m)
    request = RecognitionRequest(radius_m=parameters.r)
    try:
        document = recognise(scan.views, request, Scene(workspace_m=scan.header.workspace_m)).model.to_json()
    except RecognitionError:
        return None
    model, result = Model.from_json(document), score(document, scan.truth)
    is_right = result.topology and result.cover >= MIN_COVER if result.strings else result.chains == 0
    return is_right, model.quality.verdict, decide(model, model.grasps, may_rescan=True) not in ("rescan", "ask")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description="Counts the decisions of planner.py about simulated scenes.")
    parser.add_argument("--seeds", type=int, default=10, help="number of seeds of each scene (%(default)s)")
    parser.add_argument("--camera", choices=CAMERA_NAMES, default=DEFAULT_CAMERA, help="camera (%(default)s)")
    arguments = parser.parse_args()
    judge_case = partial(judge, camera=arguments.camera)
    print(f"| {' | '.join(COLUMNS)} |", f"|{' --- |' * len(COLUMNS)}", sep="\n")
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        for name in SCENES:
            for boxes in BOXES:
                judged = pool.map(judge_case, [(name, boxes, seed) for seed in range(arguments.seeds)])
                counts: Counter[str] = Counter()
                for result in judged:
                    if result is None:
                        counts["refused"] += 1
                        continue
                    is_right, verdict, acts = result
                    counts["right" if is_right else "wrong"] += 1
                    counts["accepted"] += is_right and verdict == "accept"
                    counts["right acts" if is_right else "wrong acts"] += acts
                names = ("right", "accepted", "right acts", "wrong", "wrong acts", "refused")
                print(f"| {name} | {boxes} | {' | '.join(str(counts[key]) for key in names)} |", flush=True)


if __name__ == "__main__":
    main()
