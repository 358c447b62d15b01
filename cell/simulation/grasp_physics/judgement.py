"""Judge the grasps of a model on the true scene."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cell.simulation.evaluation.chain_matching import ChainMatch, match_chains
from cell.simulation.evaluation.curve_distance import Polyline
from cell.simulation.evaluation.grasp_clearance import GraspClearance, grasp_clearances
from cell.simulation.grasp_physics.settings import PhysicsSettings, RobotError
from cell.simulation.grasp_physics.trial import GraspOutcome, PlannedGrasp, simulate_grasp
from cell.simulation.scenes.scenes import StringScene
from recognition.geometry.polyline import arc_length
from recognition.grasping.gripper import Gripper
from recognition.model.chains import Chain
from recognition.model.grasps import ScoredGrasp

MATCH_WINDOW_M = 0.02
"""Largest difference between the arc length of a grasp on its string by its share of the chain, and by its position."""


@dataclass(frozen=True, eq=False)
class JudgedGrasp:
    """A grasp of a model with its results."""

    rank: int
    """Rank of the grasp in the model, 0 for the best."""
    planned: PlannedGrasp | None
    """The grasp on its true string, or None if its chain matches no string."""
    clearance: GraspClearance | None
    """Clearance of the approach, or None if the chain matches no string."""
    outcome: GraspOutcome | None
    """Result of the simulation, or None without a simulation of this grasp or without a string."""
    with_errors: tuple[tuple[RobotError, GraspOutcome], ...]
    """Result of the simulation with each error of the robot."""

    @property
    def good(self) -> bool:
        """Whether the grasp lifts the right string and nothing else."""
        return self.outcome is not None and self.outcome.good

    @property
    def good_with_errors(self) -> bool:
        """Whether it does so with each error of the robot."""
        return self.good and all(outcome.good for _, outcome in self.with_errors)


def judge_grasps(
    scene: StringScene,
    chains: Sequence[Chain],
    grasps: Sequence[ScoredGrasp],
    gripper: Gripper,
    *,
    simulated: Sequence[int] | None = None,
    errors: Sequence[RobotError] = (),
    with_errors: Sequence[int] | None = None,
    settings: PhysicsSettings | None = None,
) -> list[JudgedGrasp]:
    """Measure the clearance of each grasp of a model, and simulate some of them or all.

    Args:
        scene: True scene.
        chains: Chains of the model.
        grasps: Grasps of the model, the best first.
        gripper: Dimensions of the gripper.
        simulated: Ranks of the grasps to simulate. None: all.
        errors: Errors of the robot.
        with_errors: Ranks of the grasps to simulate with each error. None: those of `simulated`.
        settings: Material and numerical parameters. None: the defaults.

    Returns:
        All grasps, in their order.
    """
    planned = plan_on_truth(scene, chains, grasps)
    chosen = set(range(len(grasps)) if simulated is None else simulated)
    disturbed = chosen if with_errors is None else set(with_errors)
    clearances = grasp_clearances(grasps, scene, gripper)
    judged = []
    for rank, (grasp, clearance) in enumerate(zip(planned, clearances, strict=True)):
        if grasp is None:
            judged.append(JudgedGrasp(rank, None, None, None, ()))
            continue
        outcome = simulate_grasp(scene, grasp, gripper, settings=settings) if rank in chosen else None
        outcomes = [
            (error, simulate_grasp(scene, grasp, gripper, error, settings)) for error in errors if rank in disturbed
        ]
        judged.append(JudgedGrasp(rank, grasp, clearance, outcome, tuple(outcomes)))
    return judged


def plan_on_truth(
    scene: StringScene, chains: Sequence[Chain], grasps: Sequence[ScoredGrasp]
) -> list[PlannedGrasp | None]:
    """Return each grasp with its true string and the arc length along it, or None if its chain matches no string.

    The chains are matched to the strings as in `cell.simulation.evaluation`. The arc length is that of the nearest
    point of the string within `MATCH_WINDOW_M` of the same share of the part that the chain covers.
    """
    strings = [Polyline.of(curve, closed) for curve, closed in zip(scene.curves, scene.closed, strict=True)]
    lines = [chain for chain in chains if len(chain.points) > 1]
    pairs = match_chains([Polyline.of(chain.points, chain.closed) for chain in lines], strings)
    match_of_id = {lines[index].id: (lines[index], match) for index, match in pairs.items()}
    planned: list[PlannedGrasp | None] = []
    for grasp in grasps:
        if grasp.chain not in match_of_id:
            planned.append(None)
            continue
        chain, match = match_of_id[grasp.chain]
        s_m = _true_arc_length(scene.curves[match.string], scene.closed[match.string], chain, match, grasp)
        planned.append(PlannedGrasp(match.string, s_m, grasp.T_base_grasp, grasp.opening_m, grasp.reach_m))
    return planned


def _true_arc_length(
    curve: NDArray[np.float64], closed: bool, chain: Chain, match: ChainMatch, grasp: ScoredGrasp
) -> float:
    """Return the arc length of a grasp along its true string, metres. The chain may cover a part of the string."""
    s = arc_length(curve)
    if closed:
        expected = match.arc_length_on_string(grasp.s_m)
        along = np.abs(s - expected)
        along = np.minimum(along, s[-1] - along)
    else:
        first, last = (s[np.linalg.norm(curve - end, axis=1).argmin()] for end in chain.points[[0, -1]])
        along = np.abs(s - (first + (last - first) * grasp.s_m / chain.length_m))
    distance = np.linalg.norm(curve - grasp.T_base_grasp[:3, 3], axis=1)
    return float(s[np.where(along <= MATCH_WINDOW_M, distance, np.inf).argmin()])
