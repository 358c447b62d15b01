"""Process each view when it arrives, while the arm moves to the next viewpoint."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from recognition.errors import DuplicateViewError, TooCrowdedError
from recognition.model.quality import ViewQuality
from recognition.parameters import ChainParameters
from recognition.preprocessing.height_map import HeightLayer, HeightMap, height_layer, merge_layers
from recognition.preprocessing.normals import NormalCloud, estimate_normals
from recognition.preprocessing.target_cloud import DepthView, Scene, TargetCloud, preprocess
from recognition.preprocessing.view_selection import MIN_VIEWS, exclusion_reason, select_views
from recognition.registration.correspondences import Correspondences, find_correspondences
from recognition.registration.registration import Registration


@dataclass(frozen=True, eq=False)
class IngestedViews:
    """Preprocessed views, ready for registration."""

    views: Sequence[DepthView]
    """All views, as they arrived."""
    targets: Sequence[TargetCloud]
    """Target clouds of all views."""
    layers: Sequence[HeightLayer]
    """Heights that each view measured, the table included."""
    clouds: Sequence[NormalCloud]
    """Points with normals of the views that show a string; empty if no view shows a string."""
    correspondences: Sequence[Correspondences]
    """Correspondences of each view in `clouds` with the earlier views in `clouds`."""
    excluded: tuple[ViewQuality, ...]
    """Excluded views, each with the reason."""
    no_string_reason: str | None
    """Why the scene has no string; None if a string is visible."""


def ingest_views(views: Iterable[DepthView], parameters: ChainParameters, scene: Scene) -> IngestedViews:
    """Preprocess each view when it arrives, and find its correspondences with the earlier views.

    Args:
        views: Depth images with their camera poses. They may arrive one by one.
        parameters: Method parameters; uses the radius r and the height threshold z_t.
        scene: Table height and workspace.

    Returns:
        The preprocessed views.

    Raises:
        DuplicateViewError: Two views have the same index.
        InsufficientViewsError: Fewer than two views were given, or fewer than two views can be used.
        NoDepthError: No view measured anything in the workspace.
        TooCrowdedError: Most views have too many points above the table for a scene of strings.
    """
    arrived: list[DepthView] = []
    targets: list[TargetCloud] = []
    layers: list[HeightLayer] = []
    clouds: list[NormalCloud] = []
    correspondences: list[Correspondences] = []
    crowded: dict[int, TooCrowdedError] = {}
    for view in views:
        if view.index in {target.view for target in targets}:
            raise DuplicateViewError(f"two views have the index {view.index}; give each view its own index")
        arrived.append(view)
        targets.append(target := preprocess(view, parameters, scene))
        layers.append(height_layer(view, target, scene))
        if exclusion_reason(target) is not None:
            continue
        try:
            cloud = estimate_normals(target, parameters)
        except TooCrowdedError as error:
            crowded[target.view] = error
            continue
        correspondences += find_correspondences(cloud, clouds, parameters)
        clouds.append(cloud)
    selection = select_views(targets)
    if selection.no_string_reason is not None:
        threshold = f"({parameters.z_t * 1000:.1f} mm for a radius of {parameters.r * 1000:.1f} mm)"
        reason = f"{selection.no_string_reason} {threshold}"
        return IngestedViews(arrived, targets, layers, (), (), selection.excluded, reason)
    if len(clouds) < max(MIN_VIEWS, len(crowded)):
        raise next(iter(crowded.values()))
    excluded = selection.excluded + tuple(
        ViewQuality(target.view, False, str(crowded[target.view]), len(target.points), code="view-crowded")
        for target in selection.used
        if target.view in crowded
    )
    return IngestedViews(arrived, targets, layers, clouds, correspondences, excluded, None)


def merge_heights(ingested: IngestedViews, registration: Registration) -> HeightMap:
    """Return the height map of the used views, each moved in the table plane by its registration.

    Args:
        ingested: Preprocessed views, with their height layers.
        registration: Registered views.

    Returns:
        The height map, in the base frame.
    """
    T_base_camera = {target.view: target.T_base_camera for target in ingested.targets}
    motions = {
        cloud.view: cloud.T_base_camera @ np.linalg.inv(T_base_camera[cloud.view])
        for cloud in registration.clouds
        if cloud.T_base_camera is not None
    }
    return merge_layers(ingested.layers, motions)
