"""Process each view when it arrives, while the arm moves to the next viewpoint."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from typing import Self

import numpy as np

from recognition.depth_correction.drawn_strings import DrawnViews, draw_into_views
from recognition.depth_correction.height_compression import (
    MAX_CHANGE,
    Ridges,
    estimate_compression,
    find_ridges,
    restore_heights,
)
from recognition.errors import TableElsewhereError, TooCrowdedError
from recognition.ingestion.seen_cells import is_single_viewpoint
from recognition.ingestion.table_and_warp import TableAndWarp
from recognition.model.quality import ViewQuality
from recognition.parameters import ChainParameters
from recognition.preprocessing.height_map import HeightLayer, HeightMap, height_layer, merge_layers
from recognition.preprocessing.normals import NormalCloud, estimate_normals
from recognition.preprocessing.table_measurement import SEARCH_M, height_far_from_table
from recognition.preprocessing.target_cloud import AlignedView, DepthView, Scene, TargetCloud, align_view, select_target
from recognition.preprocessing.view_selection import exclusion_reason, select_views
from recognition.registration.correspondences import Correspondences, compared_earlier_views, find_correspondences
from recognition.registration.measured_table import MeasuredTable
from recognition.registration.registration import Registration


@dataclass(frozen=True, eq=False)
class IngestedViews:
    """Preprocessed views, ready for registration.

    All but `measured` are from corrected depth images and in the *table frame*: the base frame, moved by
    `measured.T_base_table`, so that the table is at its given height. Both frames are equal if it is where it is given.
    """

    parameters: ChainParameters
    """Parameters with which the views were preprocessed."""
    measured: TableAndWarp
    """All views as they arrived, the warp of their camera, and where they show the table."""
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
    aligned: Sequence[AlignedView] = ()
    """All views aligned to the table plane, before heights were restored."""
    ridges: Sequence[Ridges] = ()
    """Ridges in each of them; empty without pixel locking."""
    compression: float = 1.0
    """Compression of heights that was restored in all views."""
    drawn: DrawnViews | None = None
    """All views with drawn strings, if a single viewpoint shows them in matched depth, else None."""

    @property
    def is_matched(self) -> bool:
        """Whether the depth was matched in windows: pixel locking or the bands of strings show it."""
        return self.measured.locking is not None or self.drawn is not None

    @property
    def scene(self) -> Scene:
        """Table height and workspace, as given."""
        return self.measured.scene

    @property
    def captured(self) -> list[int]:
        """Indices of all views in the order in which they were captured."""
        return [target.view for target in self.targets]

    @property
    def moved_table(self) -> MeasuredTable | None:
        """Where the views show the table, if it is not where it is given, else None."""
        table = self.measured.table
        return table if table is not None and table.is_elsewhere else None


@dataclass(eq=False)
class _Ingestion:
    """Views that have arrived, preprocessed with the table and the warp that they show."""

    parameters: ChainParameters
    measured: TableAndWarp
    targets: list[TargetCloud] = field(default_factory=list)
    layers: list[HeightLayer] = field(default_factory=list)
    clouds: list[NormalCloud] = field(default_factory=list)
    correspondences: list[Correspondences] = field(default_factory=list)
    crowded: dict[int, TooCrowdedError] = field(default_factory=dict)
    aligned: list[AlignedView] = field(default_factory=list)
    ridges: list[Ridges] = field(default_factory=list)
    compression: float = 1.0
    drawn: DrawnViews | None = None

    @classmethod
    def continue_from(cls, earlier: IngestedViews) -> Self:
        """Return the state after the views of an earlier ingestion."""
        return cls(
            parameters=earlier.parameters,
            measured=earlier.measured.copy(),
            targets=[*earlier.targets],
            layers=[*earlier.layers],
            clouds=[*earlier.clouds],
            correspondences=[*earlier.correspondences],
            crowded={**earlier.crowded},
            aligned=[*earlier.aligned],
            ridges=[*earlier.ridges],
            compression=earlier.compression,
            drawn=earlier.drawn,
        )

    def add(self, view: DepthView) -> None:
        """Preprocess a further view; all views are preprocessed again if it changes what was measured in them."""
        if self.measured.add(view) or self.drawn is not None:
            self.preprocess_again()
            return
        self._align_new_views()
        if self._has_new_compression():
            self._preprocess_all()
        else:
            self.preprocess(len(self.aligned) - 1)

    def finish(self) -> None:
        """Use what few views show, because no view follows. Raises TableElsewhereError if their table is doubtful."""
        if self.measured.finish():
            self.preprocess_again()
        if self.drawn is None and is_single_viewpoint(self.targets):
            self.drawn = draw_into_views(self.aligned, is_matched=self.measured.locking is not None)
            if self.drawn is not None:
                self.compression = self.drawn.compression
                self._preprocess_all()

    def preprocess_again(self) -> None:
        """Preprocess all views with the present errors of the camera and the present table."""
        self.aligned.clear()
        self.ridges.clear()
        self.drawn = None
        self._align_new_views()
        self.compression = estimate_compression(self.ridges, self.parameters.r)
        self._preprocess_all()

    def _align_new_views(self) -> None:
        """Align the views that were added, and find their ridges if the depth was matched in windows."""
        for number in range(len(self.aligned), len(self.measured.views)):
            aligned = align_view(self.measured.corrected(number), self.parameters, self.measured.scene)
            self.aligned.append(aligned)
            # pixel locking shows that the depth was matched; other depth has no windows that lower strings
            if self.measured.locking is not None:
                self.ridges.append(find_ridges(aligned))

    def _has_new_compression(self) -> bool:
        """Measure the compression of heights in all views. Return whether it has changed."""
        compression = estimate_compression(self.ridges, self.parameters.r)
        if abs(compression - self.compression) <= MAX_CHANGE:
            return False
        self.compression = compression
        return True

    def _preprocess_all(self) -> None:
        """Preprocess all aligned views."""
        self.targets.clear()
        self.layers.clear()
        self.clouds.clear()
        self.correspondences.clear()
        self.crowded.clear()
        for number in range(len(self.aligned)):
            self.preprocess(number)

    def preprocess(self, number: int) -> None:
        """Preprocess the next aligned view, number `number`, and pair it with the nearest of those before it."""
        aligned = self.aligned[number]
        image = aligned.view
        if self.drawn is not None:
            image = self.drawn.images[number]
        elif self.compression < 1:
            image = restore_heights(aligned, self.compression)
        target = select_target(aligned, image, self.compression)
        self.targets.append(target)
        self.layers.append(height_layer(image, target, self.measured.scene))
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


def ingest_views(
    views: Iterable[DepthView],
    parameters: ChainParameters,
    scene: Scene,
    earlier: IngestedViews | TableAndWarp | None = None,
) -> IngestedViews:
    """Preprocess each view when it arrives, and find its correspondences with the nearest earlier views.

    As soon as two views show the table where it is not given, all views are preprocessed again relative to the measured
    table. A single view suffices if no other follows. As soon as the views show a warp of the camera, all views are
    preprocessed again with corrected depth images.

    Args:
        views: Depth images with their camera poses. They may arrive one by one.
        parameters: Method parameters; uses the radius r and the height threshold z_t.
        scene: Table height and workspace.
        earlier: Result for the first of these views, or table and warp in them. They are not processed again if the
            scene is the same. With other parameters, only table and warp are not measured again.

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
    ingestion = _begin(parameters, scene, earlier)
    # The first views are those of `earlier`: they are skipped.
    ingestion.measured.views[:] = islice(views, len(ingestion.measured.views))
    for view in views:
        ingestion.add(view)
    ingestion.finish()
    selection = select_views(ingestion.targets)
    no_string_reason = None
    excluded = selection.excluded
    if selection.no_string_reason is not None:
        _refuse_distant_table(ingestion.measured.views, scene)
        threshold_note = f"({parameters.z_t * 1000:.1f} mm for a radius of {parameters.r * 1000:.1f} mm)"
        no_string_reason = f"{selection.no_string_reason} {threshold_note}"
    else:
        excluded += _crowded_views(ingestion, selection.used)
    return IngestedViews(
        parameters=parameters,
        measured=ingestion.measured,
        targets=ingestion.targets,
        layers=ingestion.layers,
        clouds=ingestion.clouds,
        correspondences=ingestion.correspondences,
        crowded=ingestion.crowded,
        excluded=excluded,
        no_string_reason=no_string_reason,
        aligned=ingestion.aligned,
        ridges=ingestion.ridges,
        compression=ingestion.compression,
        drawn=ingestion.drawn,
    )


def _begin(parameters: ChainParameters, scene: Scene, earlier: IngestedViews | TableAndWarp | None) -> _Ingestion:
    """Return the state before the first further view. See `ingest_views`."""
    if earlier is None or earlier.scene != scene:
        return _Ingestion(parameters, TableAndWarp(scene))
    if isinstance(earlier, IngestedViews) and earlier.parameters == parameters:
        return _Ingestion.continue_from(earlier)
    measured = earlier.measured if isinstance(earlier, IngestedViews) else earlier
    ingestion = _Ingestion(parameters, measured.copy())
    ingestion.preprocess_again()
    return ingestion


def _crowded_views(ingestion: _Ingestion, used: Sequence[TargetCloud]) -> tuple[ViewQuality, ...]:
    """Return the quality of each crowded view, or raise its TooCrowdedError if most views are crowded."""
    crowded = ingestion.crowded
    n_usable = len(ingestion.clouds)
    # A single view is used only if no other view contradicts it.
    if crowded and (n_usable < 2 or n_usable < len(crowded)):
        raise next(iter(crowded.values()))
    return tuple(
        ViewQuality(target.view, False, str(crowded[target.view]), len(target.points), code="view-crowded")
        for target in used
        if target.view in crowded
    )


def _refuse_distant_table(views: Sequence[DepthView], scene: Scene) -> None:
    """Raise TableElsewhereError if most views show something, but nothing near the given table."""
    heights = [z_m for view in views if (z_m := height_far_from_table(view, scene)) is not None]
    if len(heights) > len(views) / 2:
        raise TableElsewhereError(
            f"no string, and no table within {SEARCH_M * 1000:.0f} mm of z = {scene.table_z_m:g} m: what the views "
            f"show is at z = {float(np.median(heights)):.3f} m. Check table_z_m, the workspace and the camera poses"
        )


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
