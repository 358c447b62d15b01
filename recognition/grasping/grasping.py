"""Grasping stage: the grasps of a model, with what a planner needs to choose one and to carry it out."""

from collections.abc import Sequence
from dataclasses import dataclass

from recognition.assembly.checked_chains import CheckedChains
from recognition.grasping.grasp_list import list_grasps
from recognition.grasping.grasp_planner import find_grasps
from recognition.grasping.gripper import Gripper
from recognition.grasping.local_floor import LocalFloor, find_local_floor
from recognition.grasping.obstacles import gather_obstacles
from recognition.grasping.trusted_grasps import select_trusted_grasps
from recognition.model.findings import Finding
from recognition.model.grasps import Grasp
from recognition.registration.fusion import VOXEL_RADII
from recognition.surface import Surface


@dataclass(frozen=True, eq=False)
class Grasping:
    """Grasps on the chains of a scene, and the floor under them."""

    grasps: tuple[Grasp, ...]
    """Grasps on all chains: first the best of each cluster, then the others, each part with the best first."""
    findings: tuple[Finding, ...]
    """Notes on chains without grasps, and on low objects that are hidden in the noise."""
    floor: LocalFloor
    """Height of the table, and of low objects on it."""


def plan_grasps(
    checked: CheckedChains, surface: Surface, findings: Sequence[Finding], gripper: Gripper, keep_all: bool = False
) -> Grasping:
    """Return the grasps on all chains where no doubt concerns the string between the fingers.

    Args:
        checked: Chains and crossings of the model, and the measured points of strings and other objects.
        surface: Registered surface of the scene; uses the table plane and the height map.
        findings: All findings of the model.
        gripper: Gripper on the flange.
        keep_all: Whether the other grasps are kept, too. Their `trusted` is False.
    """
    chains = checked.chains
    crossings = checked.crossings
    parameters = surface.parameters
    floor = find_local_floor(surface.support, chains)
    obstacles = gather_obstacles(chains, checked.points, VOXEL_RADII * parameters.r)
    candidates = find_grasps(chains, crossings, obstacles, floor, parameters, gripper)
    selected = select_trusted_grasps(candidates, chains, crossings, findings, gripper, keep_all)
    return Grasping(list_grasps(selected.grasps, chains, crossings, obstacles, gripper), selected.findings, floor)
