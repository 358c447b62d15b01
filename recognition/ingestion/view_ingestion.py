"""Process each view when it arrives, while the arm moves to the next viewpoint."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.transforms import inverse
from recognition.errors import DuplicateViewError, TableElsewhereError, TooCrowdedError
from recognition.model.quality import ViewQuality
from recognition.parameters import ChainParameters
from recognition.preprocessing.depth_warp import (
    MAX_VIEWS,
    DepthWarp,
    TableSample,
    correct,
    is_similar,
    measure_warp,
    sample_table,
)
from recognition.preprocessing.height_map import HeightLayer, HeightMap, height_layer, merge_layers
from recognition.preprocessing.normals import NormalCloud, estimate_normals
from recognition.preprocessing.table_measurement import SEARCH_M, ViewPlane, height_far_from_table, measure_table
from recognition.preprocessing.target_cloud import DepthView, Scene, TargetCloud, preprocess
from recognition.preprocessing.view_selection import exclusion_reason, select_views
from recognition.registration.correspondences import Correspondences, compared_earlier_views, find_correspondences
from recognition.registration.measured_table import (
    MeasuredTable,
    MovedView,
    find_moved_table,
    is_near,
    locate_table,
    refuse_doubtful_table,
)
from recognition.registration.registration import Registration

EARLY_PLANES = 2
"""Minimum number of views that show the table, for a change of its place while further views may arrive. A single view
shows it less accurately."""


@dataclass(frozen=True, eq=False)
class IngestedViews:
    """Preprocessed views, ready for registration.

    If the camera has a warp, all but `views` are from corrected depth images. If the table is not where it is given,
    all but `views` and `planes` are in the frame in which it is: the base frame, moved by `T_base_table`.
    """

    parameters: ChainParameters
    """Parameters with which the views were preprocessed."""
    scene: Scene
    """Table height and workspace."""
    views: Sequence[DepthView]
    """All views, as they arrived."""
    targets: Sequence[TargetCloud]
    """Target clouds of all views."""
    layers: Sequence[HeightLayer]
    """Heights that each view measured, the table included."""
    clouds: Sequence[NormalCloud]
    """Points with normals of the views that show a string."""
    correspondences: Sequence[Correspondences]
    """Correspondences of each view in `clouds` with the nearest earlier views in `clouds`."""
    crowded: Mapping[int, TooCrowdedError]
    """Errors of the views with too many points for strings, by view index."""
    excluded: tuple[ViewQuality, ...]
    """Excluded views, each with the reason."""
    no_string_reason: str | None
    """Why the scene has no string; None if a string is visible."""
    planes: Sequence[ViewPlane | None] = ()
    """Plane of the table that each view shows at its given pose, base frame."""
    T_base_table: NDArray[np.float64] = field(default_factory=lambda: np.eye(4))
    """(4, 4) motion that moves the given table to where the views were assumed to show it, metres."""
    table: MeasuredTable | None = None
    """Where the views show the table; None if no view shows it."""
    warp: DepthWarp | None = None
    """Slow depth error of the camera that was corrected, or None."""
    samples: Sequence[TableSample | None] = ()
    """Pixels on the table in each view as captured; None for a view that shows too little of it."""

    @property
    def moved_table(self) -> MeasuredTable | None:
        """Where the views show the table, if it is not where it is given, else None."""
        return self.table if self.table is not None and self.table.is_elsewhere else None


@dataclass(eq=False)
class _Ingestion:
    """Views that have arrived, preprocessed with the table at one place and with one warp."""

    parameters: ChainParameters
    scene: Scene
    T_base_table: NDArray[np.float64] = field(default_factory=lambda: np.eye(4))
    warp: DepthWarp | None = None
    samples: list[TableSample | None] = field(default_factory=list)
    views: list[DepthView] = field(default_factory=list)
    planes: list[ViewPlane | None] = field(default_factory=list)
    targets: list[TargetCloud] = field(default_factory=list)
    layers: list[HeightLayer] = field(default_factory=list)
    clouds: list[NormalCloud] = field(default_factory=list)
    correspondences: list[Correspondences] = field(default_factory=list)
    crowded: dict[int, TooCrowdedError] = field(default_factory=dict)

    @classmethod
    def continue_from(cls, earlier: IngestedViews) -> "_Ingestion":
        """Return the state after the views of an earlier ingestion."""
        return cls(
            parameters=earlier.parameters,
            scene=earlier.scene,
            T_base_table=earlier.T_base_table,
            warp=earlier.warp,
            samples=[*earlier.samples],
            views=[*earlier.views],
            planes=[*earlier.planes],
            targets=[*earlier.targets],
            layers=[*earlier.layers],
            clouds=[*earlier.clouds],
            correspondences=[*earlier.correspondences],
            crowded={**earlier.crowded},
        )

    def arrive(self, view: DepthView) -> "_Ingestion":
        """Return the ingestion with a further view; all views are preprocessed again if it changes warp or table."""
        plane = measure_table(view, self.scene)
        self.samples.append(None if plane is None else sample_table(view, plane, self.scene))
        samples = [sample for sample in self.samples if sample is not None]
        warp = measure_warp(samples) if len(samples) <= MAX_VIEWS else self.warp
        if is_similar(warp, self.warp, samples):
            self.add(view, plane)
            return self.at_measured_table(EARLY_PLANES)
        again = _Ingestion(self.parameters, self.scene, self.T_base_table, warp, self.samples)
        for earlier in (*self.views, view):
            again.add(earlier, measure_table(earlier, self.scene) if warp is None else None)
        return again.at_measured_table(EARLY_PLANES)

    def add(self, view: DepthView, plane: ViewPlane | None) -> None:
        """Preprocess a view with the table at `T_base_table` and the current warp.

        Args:
            view: View as it was captured.
            plane: Plane of the table in this view. With a warp, it is measured again.
        """
        self.views.append(view)
        if self.warp is not None:
            view = correct(view, self.warp)
            plane = measure_table(view, self.scene)
        self.planes.append(plane)
        if not np.array_equal(self.T_base_table, np.eye(4)):
            view = MovedView(view, inverse(self.T_base_table) @ view.T_base_camera)
        self.targets.append(target := preprocess(view, self.parameters, self.scene))
        self.layers.append(height_layer(view, target, self.scene))
        if exclusion_reason(target) is not None:
            return
        try:
            cloud = estimate_normals(target, self.parameters)
        except TooCrowdedError as error:
            self.crowded[target.view] = error
            return
        self.clouds.append(cloud)
        compared = [self.clouds[k] for k in compared_earlier_views(self.clouds)]
        self.correspondences += find_correspondences(cloud, compared, self.parameters)

    def at_measured_table(self, min_planes: int = 1) -> "_Ingestion":
        """Return the ingestion of the same views with the table where they show it; itself, if it is there.

        With fewer than `min_planes` views that show the table, its place is not changed.
        """
        if sum(plane is not None for plane in self.planes) < min_planes:
            return self
        table = find_moved_table(self.planes, self.scene.table_z_m)
        T = np.eye(4) if table is None else table.T_base_table
        if is_near(T, self.T_base_table, self.planes):
            return self
        moved = _Ingestion(self.parameters, self.scene, T, self.warp, self.samples)
        for view, plane in zip(self.views, self.planes, strict=True):
            moved.add(view, plane)
        return moved


def ingest_views(
    views: Iterable[DepthView], parameters: ChainParameters, scene: Scene, earlier: IngestedViews | None = None
) -> IngestedViews:
    """Preprocess each view when it arrives, and find its correspondences with the nearest earlier views.

    As soon as two views show the table where it is not given, all views are preprocessed with the table where it is. A
    single view is, if it is the only one.
    As soon as the views show a warp of the camera, all views are preprocessed with corrected depth images.

    Args:
        views: Depth images with their camera poses. They may arrive one by one.
        parameters: Method parameters; uses the radius r and the height threshold z_t.
        scene: Table height and workspace.
        earlier: Result for the first of these views. They are not processed again, unless the parameters or the scene
            have changed.

    Returns:
        The preprocessed views.

    Raises:
        DuplicateViewError: Two views have the same index.
        InsufficientViewsError: No view was given, or only one view shows a string and others show a bare table.
        NoDepthError: No view measured anything in the workspace.
        TableElsewhereError: The views show the table too far from where it is given, two planes may be the table, or
            there is no string and all that the views show is far from the given table.
        DepthNoiseError: In most views, noise of the table reaches the height threshold.
        TooCrowdedError: Most views have too many points above the table for a scene of strings.
    """
    views = iter(views)
    ingestion = _Ingestion(parameters, scene)
    if earlier is not None and (earlier.parameters, earlier.scene) == (parameters, scene):
        ingestion = _Ingestion.continue_from(earlier)
        ingestion.views[:] = islice(views, len(ingestion.views))
    for view in views:
        if view.index in {target.view for target in ingestion.targets}:
            raise DuplicateViewError(f"two views have the index {view.index}; give each view its own index")
        ingestion = ingestion.arrive(view)
    ingestion = ingestion.at_measured_table()
    table = locate_table([plane for plane in ingestion.planes if plane is not None], scene.table_z_m)
    if table is not None and table.is_elsewhere:
        refuse_doubtful_table(table, ingestion.planes)
    targets, clouds, crowded = ingestion.targets, ingestion.clouds, ingestion.crowded
    selection = select_views(targets)
    no_string_reason, excluded = None, selection.excluded
    if selection.no_string_reason is not None:
        _refuse_distant_table(ingestion.views, scene)
        threshold = f"({parameters.z_t * 1000:.1f} mm for a radius of {parameters.r * 1000:.1f} mm)"
        no_string_reason = f"{selection.no_string_reason} {threshold}"
    else:
        # A single view is used only if no other view contradicts it.
        if crowded and len(clouds) < max(2, len(crowded)):
            raise next(iter(crowded.values()))
        excluded += tuple(
            ViewQuality(target.view, False, str(crowded[target.view]), len(target.points), code="view-crowded")
            for target in selection.used
            if target.view in crowded
        )
    return IngestedViews(
        parameters=parameters,
        scene=scene,
        views=ingestion.views,
        targets=targets,
        layers=ingestion.layers,
        clouds=clouds,
        correspondences=ingestion.correspondences,
        crowded=crowded,
        excluded=excluded,
        no_string_reason=no_string_reason,
        planes=ingestion.planes,
        T_base_table=ingestion.T_base_table,
        table=table,
        warp=ingestion.warp,
        samples=ingestion.samples,
    )


def _refuse_distant_table(views: Sequence[DepthView], scene: Scene) -> None:
    """Raise TableElsewhereError if most views show something, but nothing near the given table."""
    heights = [z_m for view in views if (z_m := height_far_from_table(view, scene)) is not None]
    if len(heights) > len(views) / 2:
        raise TableElsewhereError(
            f"no string, and no table within {SEARCH_M * 1000:.0f} mm of z = {scene.table_z_m:g} m: what the views "
            f"show is at z = {float(np.median(heights)):.3f} m. Check table_z_m, the workspace and the camera poses"
        )


def correct_views(views: Sequence[DepthView], scene: Scene) -> Sequence[DepthView]:
    """Return the views without the warp of the camera, and with poses relative to the measured table.

    The views are returned as they are if the camera has no warp and the table is where it is given.
    """
    planes = [measure_table(view, scene) for view in views]
    samples = [sample_table(view, plane, scene) for view, plane in zip(views, planes, strict=True) if plane is not None]
    warp = measure_warp([sample for sample in samples if sample is not None])
    if warp is not None:
        views = [correct(view, warp) for view in views]
        planes = [measure_table(view, scene) for view in views]
    table = find_moved_table(planes, scene.table_z_m)
    if table is None:
        return views
    refuse_doubtful_table(table, planes)
    return [MovedView(view, inverse(table.T_base_table) @ view.T_base_camera) for view in views]


def merge_heights(ingested: IngestedViews, registration: Registration) -> HeightMap:
    """Return the height map of the used views, each moved in the table plane by its registration.

    The map is in the frame of `ingested`.

    Args:
        ingested: Preprocessed views, with their height layers.
        registration: Registered views.

    Returns:
        The height map.
    """
    T_base_camera = {target.view: target.T_base_camera for target in ingested.targets}
    motions = {
        cloud.view: cloud.T_base_camera @ np.linalg.inv(T_base_camera[cloud.view])
        for cloud in registration.clouds
        if cloud.T_base_camera is not None
    }
    return merge_layers(ingested.layers, motions)
