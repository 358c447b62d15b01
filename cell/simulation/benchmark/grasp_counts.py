"""Count the grasps of the benchmark that touch something they should not, by the true geometry of the scenes."""

from collections.abc import Sequence
from dataclasses import dataclass

from cell.simulation.evaluation.grasp_clearance import grasp_clearances
from cell.simulation.scenes.scenes import StringScene
from recognition.grasping.gripper import Gripper
from recognition.model.grasps import ScoredGrasp


@dataclass(frozen=True)
class JudgedGrasps:
    """Grasps of one model. A grasp may count for several contacts."""

    grasps: int
    """Number of grasps."""
    on_table: int
    """Number of grasps with a finger in the table, on the approach or while the fingers close."""
    on_object: int
    """The same with a box."""
    on_string: int
    """The same with a strand that is not gripped."""
    on_gripped: int
    """Number of grasps with a finger in the gripped strand, before the fingers close."""
    by_palm: int
    """Number of grasps whose palm touches the table, a box or a strand."""
    off_string: int
    """Number of grasps farther from every true centre line than the radius of the string."""
    touching: int
    """Number of grasps whose fingers or palm touch the table, a box or a strand that is not gripped."""
    best_touches: bool
    """Whether the best grasp is one of them."""


@dataclass(frozen=True)
class GraspCounts:
    """Grasps of several models."""

    scenes: int
    """Number of models."""
    with_grasps: int
    """Number of models with a grasp."""
    with_touching: int
    """Number of models with a grasp that touches something."""
    best_touching: int
    """Number of models whose best grasp touches something."""
    grasps: int
    on_table: int
    on_object: int
    on_string: int
    on_gripped: int
    by_palm: int
    off_string: int
    touching: int
    """Sums of the fields of `JudgedGrasps` with the same names."""


def judge_grasps(grasps: Sequence[ScoredGrasp], scene: StringScene, gripper: Gripper | None = None) -> JudgedGrasps:
    """Judge the grasps of a model by the true scene.

    Args:
        grasps: Grasps of the model, the best first.
        scene: True scene.
        gripper: Gripper for which the grasps were planned. None: the default gripper.
    """
    found = grasp_clearances(grasps, scene, gripper or Gripper())
    contacts = [clearance.finger_contact for clearance in found]
    return JudgedGrasps(
        grasps=len(found),
        on_table=sum("table" in contact for contact in contacts),
        on_object=sum("box" in contact for contact in contacts),
        on_string=sum("string" in contact for contact in contacts),
        on_gripped=sum("gripped" in contact for contact in contacts),
        by_palm=sum(bool(clearance.palm.contact) for clearance in found),
        off_string=sum(
            clearance.string < 0 or clearance.off_m > scene.radii_m[clearance.string] for clearance in found
        ),
        touching=sum(clearance.touches for clearance in found),
        best_touches=bool(found) and found[0].touches,
    )


def count_grasps(judged: Sequence[JudgedGrasps]) -> GraspCounts:
    """Sum the grasps of several models."""
    sums = {
        name: sum(getattr(scene, name) for scene in judged)
        for name in ("grasps", "on_table", "on_object", "on_string", "on_gripped", "by_palm", "off_string", "touching")
    }
    return GraspCounts(
        scenes=len(judged),
        with_grasps=sum(scene.grasps > 0 for scene in judged),
        with_touching=sum(scene.touching > 0 for scene in judged),
        best_touching=sum(scene.best_touches for scene in judged),
        **sums,
    )
