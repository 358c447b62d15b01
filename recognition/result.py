"""Result of a recognition: the model, and what each stage made of the views."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

from recognition.assembly.table_frame import move_heights, move_model, move_registration
from recognition.grasping.grasping import Grasping
from recognition.methods import NO_STAGES, MethodStages
from recognition.model.findings import Finding
from recognition.model.model import PointChainModel
from recognition.preprocessing.height_map import HeightMap
from recognition.preprocessing.target_cloud import TargetCloud
from recognition.registration.registration import Registration
from recognition.surface import Surface


@dataclass(frozen=True, eq=False)
class Recognition:
    """Model of a scene, and the result of each stage. The results of stages that did not run are None.

    The stages work in the table frame (see `IngestedViews`). The model, the registration and the height map are in the
    base frame.
    """

    model: PointChainModel
    """The point chain model."""
    surface: Surface
    """Surface above the table, and what the views saw of the workspace, in the table frame."""
    registration: Registration | None = None
    """Registered views, and their merged point cloud with normals."""
    height_map: HeightMap | None = None
    """Height of the table and of all that lies on it, from all views."""
    stages: MethodStages = NO_STAGES
    """Result of each stage of the method, from the centre line to the strands, in the table frame."""
    grasping: Grasping | None = None
    """Grasps, and the floor for the fingertips."""

    @property
    def targets(self) -> Sequence[TargetCloud]:
        """Points of each view above the height threshold."""
        return self.surface.ingested.targets

    def with_findings(self, added: Sequence[Finding]) -> Self:
        """Return the recognition with further findings of its model."""
        quality = self.model.quality.with_findings(added)
        return replace(self, model=replace(self.model, quality=quality))


def in_base_frame(recognition: Recognition) -> Recognition:
    """Return the recognition with its model, registration and height map in the base frame."""
    table = recognition.surface.ingested.moved_table
    if table is None:
        return recognition
    # Ingestion ignores small changes of the table. Each view is aligned to the table plane all the same.
    T = table.T_base_table
    registration = recognition.registration
    heights = recognition.height_map
    return replace(
        recognition,
        model=move_model(recognition.model, T),
        registration=registration and move_registration(registration, T),
        height_map=heights and move_heights(heights, T),
    )
