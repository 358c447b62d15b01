"""Recognise strings in depth images from your own program, without the service.

The views here are simulated. Put your own depth images and camera poses in their place: any object with the five
attributes of `MyView` is a view.

    python examples/recognise_as_library.py
"""

import json
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cell.simulation.offline_scan import simulate
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.scenes import make_scene
from recognition.model import PointChainModel
from recognition.pipeline import recognise
from recognition.preprocessing import Scene
from recognition.request import RecognitionRequest

RADIUS_M = 0.0042


@dataclass(frozen=True, eq=False)
class MyView:
    """One depth image and its camera pose."""

    index: int
    """Number of the view, different for each view."""
    depth: NDArray[np.uint16]
    """(H, W) depth along the optical axis in units of `depth_unit_m`; 0 = not measured."""
    depth_unit_m: float
    """Metres per depth count."""
    K: NDArray[np.float64]
    """(3, 3) pinhole matrix, pixels."""
    T_base_camera: NDArray[np.float64]
    """(4, 4) camera pose; maps camera points (x right, y down, z forward) to the base frame, metres."""


def my_views() -> list[MyView]:
    """Return eight simulated views of an overhand knot."""
    scan = simulate(make_scene("overhand-knot", seed=3), camera_model("ideal"), seed=3)
    return [MyView(view.index, view.depth, view.depth_unit_m, view.K, view.T_base_camera) for view in scan.views]


def report(model: PointChainModel) -> None:
    """Print the chains, the crossings, and what the model is not sure about."""
    for chain in model.chains:
        first, last = chain.points[[0, -1]] * 1000
        print(f"chain {chain.id}: {chain.length_m * 1000:.0f} mm, {len(chain.points)} points")
        print(f"  from {first.round(1)} to {last.round(1)} mm, ends {chain.ends[0]} and {chain.ends[1]}")
        print(f"  sigma {np.median(chain.sigma_m) * 1000:.2f} mm, seen by {np.median(chain.views):.0f} views (medians)")
    for crossing in model.crossings:
        over, under = crossing.over, crossing.under
        print(
            f"crossing {crossing.id}: chain {over.chain} at {over.s_m * 1000:.0f} mm over chain {under.chain} at "
            f"{under.s_m * 1000:.0f} mm, {crossing.gap_m * 1000:.1f} mm apart, confidence {crossing.confidence:.2f}"
        )
    print(f"verdict: {model.quality.verdict}")
    for finding in model.quality.findings:
        print(f"{finding.severity}: {finding.message} [{finding.code}]")


def main() -> None:
    """Recognise the views, print the model, and save it if a file is named."""
    scene = Scene(table_z_m=0.0, workspace_m=((-0.3, 0.3), (-0.3, 0.3), (0.0, 0.12)))
    model = recognise(my_views(), RecognitionRequest(radius_m=RADIUS_M), scene).model
    report(model)
    if len(sys.argv) > 1:
        Path(sys.argv[1]).write_text(json.dumps(model.to_json()))


if __name__ == "__main__":
    main()
