"""Ingestion of views: all work that a single view allows is done when it arrives, while the arm moves on."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from recognition.errors import DuplicateViewError, TooCrowdedError
from recognition.model.quality import ViewQuality
from recognition.parameters import ChainParameters
from recognition.preprocessing.normals import NormalCloud, estimate_normals
from recognition.preprocessing.target_cloud import DepthView, Scene, TargetCloud, preprocess
from recognition.preprocessing.view_selection import MIN_VIEWS, exclusion_reason, select_views
from recognition.registration.correspondences import Correspondences, find_correspondences


@dataclass(frozen=True, eq=False)
class IngestedViews:
    """The preprocessed views before registration."""

    targets: Sequence[TargetCloud]
    """Target clouds of all views."""
    clouds: Sequence[NormalCloud]
    """Clouds with normals of the views that see a string; none if there is no string."""
    correspondences: Sequence[Correspondences]
    """Corresponding points of each of these views and those before it."""
    excluded: tuple[ViewQuality, ...]
    """The other views, each with the reason."""
    no_string_reason: str | None
    """Why there is no string. None if there is one."""


def ingest_views(views: Iterable[DepthView], parameters: ChainParameters, scene: Scene) -> IngestedViews:
    """Preprocess each view when it arrives and find its correspondences with the views before it.

    Args:
        views: Depth images with their camera poses. They may arrive one by one.
        parameters: Radii and thresholds.
        scene: Height of the table and workspace in the base frame.

    Returns:
        The preprocessed views.

    Raises:
        DuplicateViewError: Two views have the same index.
        InsufficientViewsError: Fewer than two views were given, or fewer can be used.
        NoDepthError: No view measured anything in the workspace.
        TooCrowdedError: In most views, much more than strings is above the table.
    """
    targets: list[TargetCloud] = []
    clouds: list[NormalCloud] = []
    correspondences: list[Correspondences] = []
    crowded: dict[int, TooCrowdedError] = {}
    for view in views:
        if view.index in {target.view for target in targets}:
            raise DuplicateViewError(f"two views have the index {view.index}; give each view its own index")
        targets.append(target := preprocess(view, parameters, scene))
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
        return IngestedViews(targets, (), (), selection.excluded, f"{selection.no_string_reason} {threshold}")
    if len(clouds) < max(MIN_VIEWS, len(crowded)):
        raise next(iter(crowded.values()))
    excluded = selection.excluded + tuple(
        ViewQuality(target.view, False, str(crowded[target.view]), len(target.points))
        for target in selection.used
        if target.view in crowded
    )
    return IngestedViews(targets, clouds, correspondences, excluded, None)
