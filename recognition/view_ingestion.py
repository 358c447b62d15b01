"""Process each view when it arrives, while the arm moves to the next viewpoint."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np

from recognition.errors import DuplicateViewError, TooCrowdedError
from recognition.model.quality import ViewQuality
from recognition.parameters import ChainParameters
from recognition.preprocessing.height_map import HeightLayer, HeightMap, height_layer, merge_layers
from recognition.preprocessing.normals import NormalCloud, estimate_normals
from recognition.preprocessing.target_cloud import DepthView, Scene, TargetCloud, preprocess
from recognition.preprocessing.view_selection import MIN_VIEWS, exclusion_reason, select_views
from recognition.registration.correspondences import Correspondences, compared_earlier_views, find_correspondences
from recognition.registration.registration import Registration


@dataclass(frozen=True, eq=False)
class IngestedViews:
    """Preprocessed views, ready for registration."""

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


def ingest_views(
    views: Iterable[DepthView], parameters: ChainParameters, scene: Scene, earlier: IngestedViews | None = None
) -> IngestedViews:
    """Preprocess each view when it arrives, and find its correspondences with the nearest earlier views.

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
    views = iter(views)
    if earlier is not None and (earlier.parameters, earlier.scene) == (parameters, scene):
        arrived, targets, layers = [*islice(views, len(earlier.views))], [*earlier.targets], [*earlier.layers]
        clouds, correspondences = [*earlier.clouds], [*earlier.correspondences]
        crowded = {**earlier.crowded}
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
        clouds.append(cloud)
        compared = [clouds[k] for k in compared_earlier_views(clouds)]
        correspondences += find_correspondences(cloud, compared, parameters)
    selection = select_views(targets)
    no_string_reason, excluded = None, selection.excluded
    if selection.no_string_reason is not None:
        threshold = f"({parameters.z_t * 1000:.1f} mm for a radius of {parameters.r * 1000:.1f} mm)"
        no_string_reason = f"{selection.no_string_reason} {threshold}"
    else:
        if len(clouds) < max(MIN_VIEWS, len(crowded)):
            raise next(iter(crowded.values()))
        excluded += tuple(
            ViewQuality(target.view, False, str(crowded[target.view]), len(target.points), code="view-crowded")
            for target in selection.used
            if target.view in crowded
        )
    return IngestedViews(
        parameters=parameters,
        scene=scene,
        views=arrived,
        targets=targets,
        layers=layers,
        clouds=clouds,
        correspondences=correspondences,
        crowded=crowded,
        excluded=excluded,
        no_string_reason=no_string_reason,
    )


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
