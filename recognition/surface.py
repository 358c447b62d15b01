"""The measured surface above the table, and what the views saw of the workspace."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from recognition.ingestion.seen_cells import SeenCells, measure_seen_cells
from recognition.ingestion.table_and_warp import TableAndWarp
from recognition.ingestion.view_ingestion import IngestedViews, ingest_views, merge_heights
from recognition.model.quality import ViewQuality
from recognition.parameters import ChainParameters
from recognition.preprocessing.normals import NormalCloud
from recognition.preprocessing.support_surface import SupportSurface
from recognition.preprocessing.table_scatter import median_patch_m
from recognition.preprocessing.target_cloud import DepthView, Scene
from recognition.registration.registration import NO_REGISTRATION, Registration, register
from recognition.registration.table_error import add_table_error
from recognition.stage_timer import Begin, ignore_stage
from recognition.tracing.occlusion_map import OcclusionMap

Points = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Surface:
    """Registered surface of a scene, in the table frame (see `IngestedViews`)."""

    ingested: IngestedViews
    """Preprocessed views, the warp of their camera, and where they show the table."""
    registration: Registration
    """Registered views. Without a string in view, there are none."""
    points: Points
    """(N, 3) points of strings and objects above the table, metres."""
    normals: Points
    """(N, 3) outward unit normals of the points."""
    support: SupportSurface
    """The table plane and the height map of all used views, on which strings rest."""
    occlusion_map: OcclusionMap
    """Whole surface, from above and from the cameras. It also hides what is not in `points`."""
    clouds: tuple[NormalCloud, ...] = ()
    """Registered views with depth images, which show gaps and ends. Without them, both are where the surface ends."""
    known_lines: tuple[Points, ...] = ()
    """(K, 3) centre lines of strings whose surface is not in `points`, metres."""

    @property
    def scene(self) -> Scene:
        """Table height and workspace, as given."""
        return self.ingested.scene

    @property
    def parameters(self) -> ChainParameters:
        """Method parameters with which the surface was observed."""
        return self.ingested.parameters

    @property
    def no_string_reason(self) -> str | None:
        """Why the scene has no string; None if a string is visible."""
        return self.ingested.no_string_reason

    @property
    def views_quality(self) -> tuple[ViewQuality, ...]:
        """How each view is used, and why others are excluded."""
        return self.registration.views + self.ingested.excluded

    @cached_property
    def seen(self) -> SeenCells:
        """What the views saw of each cell of the table, whether or not it shows a string. Computed at the first use."""
        registered = {cloud.view: cloud for cloud in self.registration.clouds}
        views = [registered.get(target.view, target) for target in self.ingested.targets]
        return measure_seen_cells(views, self.ingested.layers, self.scene.table_z_m, self.parameters.r)


def observe(
    views: Iterable[DepthView],
    scene: Scene,
    parameters: ChainParameters,
    *,
    begin: Begin = ignore_stage,
    earlier: Surface | TableAndWarp | None = None,
) -> Surface:
    """Preprocess and register the views, and return the surface that they show.

    Args:
        views: Depth images with their camera poses. They may arrive one by one.
        scene: Table height and workspace in the base frame.
        parameters: Method parameters; uses the radius r and the height threshold z_t.
        begin: Called with the name of the next stage, `registration`, when all views are preprocessed.
        earlier: Surface of the first of these views, or table and warp in them. They are not measured again.

    Returns:
        The surface. If no string is in view, it has no points, and `no_string_reason` says why.

    Raises:
        RecognitionError: The views cannot be used, as for `recognition.pipeline.recognise`.

    Source:
        Sections II.A to II.E.
    """
    known = earlier.ingested if isinstance(earlier, Surface) else earlier
    ingested = ingest_views(views, parameters, scene, known)
    if ingested.no_string_reason is not None:
        return Surface(
            ingested=ingested,
            registration=NO_REGISTRATION,
            points=NO_REGISTRATION.points,
            normals=NO_REGISTRATION.normals,
            support=SupportSurface(scene.table_z_m),
            occlusion_map=OcclusionMap(NO_REGISTRATION.points),
        )

    begin("registration")
    sigmas = ingested.measured.pose_sigmas
    registration = register(ingested.clouds, parameters, ingested.correspondences, sigmas, scene.table_z_m)
    registration = add_table_error(registration, ingested.measured.table, sigmas)
    return Surface(
        ingested=ingested,
        registration=registration,
        points=registration.points,
        normals=registration.normals,
        support=SupportSurface(
            scene.table_z_m,
            merge_heights(ingested, registration),
            is_matched=ingested.is_matched,
            scatter_m=median_patch_m(target.scatter for target in ingested.targets) or 0.0,
        ),
        occlusion_map=OcclusionMap(registration.points, registration.clouds),
        clouds=registration.clouds,
    )
