"""Streams of poses that are not ours: the solver against the baselines of the kinhec benchmark, under its protocol.

What is drawn and how it is judged is the benchmark's: a camera on the flange of various arms, noise of many levels,
poses from pictures of a board, and up to half of the views wrong. Translation error of X, as its own tables have it.
"""

import numpy as np
import pytest
from kinhec.benchmark import SOLVERS, evaluate_sequence
from kinhec.config import SequenceConfig
from kinhec.generator import GenerationError, generate_sequence
from kinhec.io import Sequence
from kinhec.plans import build_plan, load_tier

from calibration.geometry.se3 import invert_poses
from calibration.hand_eye import solve_poses

OURS = "pointchain"


def ours(data, rng):
    """As the benchmark calls a solver: (T_base_flange, T_board_camera, ...)."""
    T_base_flange, T_board_camera, _, _ = data
    result = solve_poses(T_base_flange, invert_poses(T_board_camera))
    return {"X": result.X, "Y": result.Y}


def sequence(config: SequenceConfig) -> Sequence:
    """With the benchmark's own second tries, so that the sequences are those of its data set."""
    for attempt in range(5):
        try:
            record = generate_sequence(config)
        except GenerationError:
            config.seed = (config.seed * 1103515245 + 12345 + attempt) % (2**31 - 1)
        else:
            return Sequence(record.manifest, record.robot_table, record.camera_table)
    raise AssertionError(f"{config.sequence_id} cannot be generated")


def errors_mm(tier: str, track: str, solvers: list[str], wanted: slice | None = None) -> dict[str, np.ndarray]:
    """Of each solver, one error per sequence; a failure is an infinite one."""
    SOLVERS[OURS] = ours
    try:
        plan = build_plan(load_tier(tier), [track])[track]
        configs = [config for config in plan if config.configuration == "eye_in_hand"][wanted or slice(None)]
        rows = [
            row
            for number, config in enumerate(configs)
            for row in evaluate_sequence(sequence(config), [OURS, *solvers], rng=np.random.default_rng(number))
        ]
    finally:
        del SOLVERS[OURS]
    return {
        solver: np.array(
            [row["X_trans_err_mm"] if row["ok"] else np.inf for row in rows if row["solver"] == solver],
            dtype=np.float64,
        )
        for solver in [OURS, *solvers]
    }


def medians(errors: dict[str, np.ndarray]) -> tuple[float, float]:
    """Ours, and that of the best baseline."""
    return float(np.median(errors[OURS])), min(float(np.median(e)) for name, e in errors.items() if name != OURS)


@pytest.mark.parametrize(
    ("track", "best", "wanted"),
    [
        ("noise", ["shah", "park_martin"], slice(0, 4)),  # one arm's: each takes seconds to generate
        ("pnp", ["shah"], None),
        ("outliers", ["ransac_park_martin"], slice(2, 4)),  # those with outliers
    ],
)
def test_smoke_tier(track, best, wanted):
    # The fast ones of the baselines that lead each track's table; the whole table is judged in the small tier.
    mine, baseline = medians(errors_mm("smoke", track, best, wanted))
    assert mine <= 1.05 * baseline


@pytest.mark.soak
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("track", ["noise", "pnp", "outliers"])
def test_small_tier(track):
    baselines = [name for name in SOLVERS if name != OURS]
    errors = errors_mm("small", track, baselines)
    mine, baseline = medians(errors)
    assert mine <= 1.05 * baseline
    if track == "outliers":
        assert np.percentile(errors[OURS], 95) <= 4.0
