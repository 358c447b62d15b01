"""All that can be done with a view when it arrives, while the arm moves to the next one."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from recognition.errors import RecognitionError, TooCrowdedError
from recognition.model.model import ViewQuality
from recognition.parameters import ChainParameters
from recognition.preprocessing.normals import NormalCloud, estimate_normals
from recognition.preprocessing.target_cloud import DepthView, Scene, TargetCloud, preprocess
from recognition.preprocessing.view_selection import MIN_VIEWS, exclusion_reason, select_views
from recognition.registration.correspondences import Correspondences, find_correspondences


class DuplicateViewError(RecognitionError):
    """Two views have the same index."""

    slug = "duplicate-view"


@dataclass(frozen=True, eq=False)
class IngestedViews:
    """The views as they are before registration."""

    targets: Sequence[TargetCloud]
    """Of every view."""
    clouds: Sequence[NormalCloud]
    """Of those that see a string; none when there is no string."""
    pairs: Sequence[Correspondences]
    """Where these show the same surface, each and those before it."""
    left_out: tuple[ViewQuality, ...]
    """The other views, with their reasons."""
    empty_because: str | None
    """Why there is no string, when there is none."""


def ingest_views(views: Iterable[DepthView], parameters: ChainParameters, scene: Scene) -> IngestedViews:
    """Target cloud, normals and overlaps of each view, as it comes.

    Raises:
        DuplicateViewError: two views have the same index.
        InsufficientViewsError, NoDepthError: see `recognition.preprocessing.view_selection.select_views`.
        TooCrowdedError: most views have more above the table than strings.
    """
    targets: list[TargetCloud] = []
    clouds: list[NormalCloud] = []
    pairs: list[Correspondences] = []
    crowded: dict[int, TooCrowdedError] = {}
    for view in views:
        if view.index in {target.view for target in targets}:
            raise DuplicateViewError(f"two views have the index {view.index}; each must have its own")
        targets.append(target := preprocess(view, parameters, scene))
        if exclusion_reason(target) is not None:
            continue
        try:
            cloud = estimate_normals(target, parameters)
        except TooCrowdedError as error:
            crowded[target.view] = error
            continue
        pairs += find_correspondences(cloud, clouds, parameters)
        clouds.append(cloud)
    seen, left_out, empty_because = select_views(targets)
    if empty_because is not None:
        of_radius = f"({parameters.z_t * 1000:.1f} mm for a radius of {parameters.r * 1000:.1f} mm)"
        return IngestedViews(targets, (), (), left_out, f"{empty_because} {of_radius}")
    if len(clouds) < max(MIN_VIEWS, len(crowded)):
        raise next(iter(crowded.values()))
    left_out += tuple(
        ViewQuality(target.view, False, str(crowded[target.view]), len(target.points))
        for target in seen
        if target.view in crowded
    )
    return IngestedViews(targets, clouds, pairs, left_out, None)
