"""Straight strings, their grasps, and points in the fingers, for the tests of grasps."""

import numpy as np

from recognition.grasping.grasp_planner import find_grasps
from recognition.grasping.gripper import Gripper
from recognition.grasping.local_floor import LocalFloor
from recognition.grasping.obstacles import gather_obstacles
from recognition.model.chains import Chain, Crossing
from recognition.model.findings import Finding
from recognition.model.grasps import ScoredGrasp
from recognition.parameters import ChainParameters
from recognition.registration.fusion import VOXEL_RADII

R = 0.0042
PARAMETERS = ChainParameters.for_radius(R)
GRIPPER = Gripper()
HALF_FINGER = GRIPPER.finger_width_m / 2
NOTHING = np.empty((0, 3))
TABLE_Z = 0.3
"""Not 0, so that a height and a height above the table differ."""
BARE_TABLE = LocalFloor(-50.0, -50.0, 100.0, np.full((1, 1), TABLE_Z), np.zeros((1, 1), dtype=bool), 0.0012, TABLE_Z)
"""A table without objects, in one cell."""


def chain(points: np.ndarray, number: int = 0, closed: bool = False, sigma: float = 0.0, r: float = R) -> Chain:
    n = len(points)
    return Chain(number, closed, r, points, np.full(n, sigma), np.full(n, 8, dtype=np.int64), ("free", "free"))


def straight(
    y: float = 0.0, z: float = R, length: float = 0.2, degrees: float = 0.0, number: int = 0, r: float = R
) -> Chain:
    """A string along x, turned about the origin, in its middle."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    x = np.linspace(-length / 2, length / 2, 51)
    return chain(np.column_stack([c * x - s * y, s * x + c * y, np.full(51, TABLE_Z + z)]), number, r=r)


def grasps_of(
    *chains: Chain,
    crossings: tuple[Crossing, ...] = (),
    surface: np.ndarray = NOTHING,
    gripper: Gripper = GRIPPER,
    parameters: ChainParameters = PARAMETERS,
    floor: LocalFloor = BARE_TABLE,
) -> tuple[tuple[ScoredGrasp, ...], tuple[Finding, ...]]:
    """Return the grasps, and the findings. Each finding must be the note on a chain without a grasp."""
    obstacles = gather_obstacles(chains, surface, VOXEL_RADII * parameters.r)
    found = find_grasps(chains, crossings, obstacles, floor, parameters, gripper)
    assert {(note.code, note.severity) for note in found.findings} <= {("no-grasp", "note")}
    without = {one.id for one in chains} - {grasp.chain for grasp in found.grasps}
    assert sorted(note.chains for note in found.findings) == [(number,) for number in sorted(without)]
    return found.grasps, found.findings


def finger_points(grasp: ScoredGrasp) -> np.ndarray:
    """Points in both fingers, base frame, less than 2 mm apart, from the tips to 30 mm before them."""
    inner = grasp.opening_m / 2
    x = np.concatenate([side * np.linspace(inner, inner + GRIPPER.finger_thickness_m, 4) for side in (-1, 1)])
    y = np.linspace(-HALF_FINGER, HALF_FINGER, 7)
    z = grasp.reach_m - np.linspace(0, 0.03, 17)
    grid = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1).reshape(-1, 3)
    return grid @ grasp.T_base_grasp[:3, :3].T + grasp.T_base_grasp[:3, 3]
