"""Compare scans that take views as needed with scans of eight views, at the viewpoints of the default cell."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from cell.camera.frame_averaging import median
from cell.config.camera_config import SimulatedCamera
from cell.config.camera_names import DEFAULT_CAMERA, CameraName
from cell.config.cell_config import CellSettings
from cell.devices import View
from cell.planning.viewpoints import plan_viewpoints
from cell.simulation.benchmark.tables import table_row
from cell.simulation.benchmark.worker_pool import map_in_processes
from cell.simulation.cases import Case, make_case
from cell.simulation.devices.frame_source import FrameSource
from cell.simulation.devices.world import simulated_world, world_truth
from cell.simulation.evaluation.metrics import Score, score
from cell.simulation.pose_errors import PoseErrors
from recognition.early_end.stepwise import recognise_after_each_view
from recognition.early_end.view_sufficiency import MIN_SUFFICIENT_VIEWS, ViewCheck
from recognition.errors import RecognitionError
from recognition.model.trust import Verdict
from recognition.pipeline import recognise
from recognition.preprocessing.target_cloud import DepthView, Scene
from recognition.request import RecognitionRequest
from recognition.result import Recognition

VIEWS_TIERS = ("paper", "long", "many", "physical", "soft", "photo", "hard", "fixtures")
"""Tiers whose errors and number of views the simulated cell has. It has no smooth errors of the flange pose, as tier
`measured` needs."""
BORDER_M = 0.008
"""Smallest distance of a string from the border of the workspace. A string that ends there is cut short."""


VIEWS_COLUMNS = (
    "tier",
    "scenes",
    "four views enough",
    "views, mean",
    "topology right, `auto`",
    "eight",
    "wrong without a doubt, `auto`",
    "eight",
    "mean error, `auto`",
    "eight",
    "worst end, `auto`",
    "eight",
)
"""Column headings of the table. Each pair is for `auto` and for eight views."""


@dataclass(frozen=True)
class ViewsResult:
    """Result of one scan."""

    score: Score | None
    """Score of the model, or None if recognition refused the views."""
    verdict: Verdict | None
    """Verdict of the model, or None if recognition refused the views."""

    @property
    def is_right(self) -> bool:
        """Whether the topology is right."""
        return self.score is not None and self.score.topology

    @property
    def is_silently_wrong(self) -> bool:
        """Whether the topology is wrong although the verdict is `accept`."""
        return not self.is_right and self.verdict == "accept"


@dataclass(frozen=True)
class ViewsCase:
    """Results of both scans of one scene."""

    tier: str
    """Name of the tier."""
    seed: int
    """Seed of the case."""
    views: int
    """Number of views that the scan with views as needed took."""
    auto: ViewsResult
    """Result of the scan that takes views as needed."""
    eight: ViewsResult
    """Result of the scan of eight views."""


@dataclass(frozen=True)
class ViewsSummary:
    """Results of one tier. Distances are medians over the scenes, millimetres; None without a distance."""

    scenes: int
    """Number of scenes that lie in the workspace."""
    four_views: int
    """Number of scenes in which four views were enough."""
    mean_views: float | None
    """Mean number of views, or None without a scene."""
    auto_right: int
    """Number of scenes with the right topology, with views as needed."""
    eight_right: int
    """Number of scenes with the right topology, with eight views."""
    auto_silently_wrong: int
    """Number of scenes with a wrong topology and the verdict `accept`, with views as needed."""
    eight_silently_wrong: int
    """Number of scenes with a wrong topology and the verdict `accept`, with eight views."""
    auto_mean_mm: float | None
    """Mean error, with views as needed."""
    eight_mean_mm: float | None
    """Mean error, with eight views."""
    auto_end_mm: float | None
    """Error of the worst end, with views as needed."""
    eight_end_mm: float | None
    """Error of the worst end, with eight views."""


def run_views_case(tier_and_seed: tuple[str, int], camera: CameraName = DEFAULT_CAMERA) -> ViewsCase | None:
    """Simulate the views of the default cell on the scene of a case, and recognise them as both scans do.

    Args:
        tier_and_seed: Name of one of `VIEWS_TIERS`, and seed of the case.
        camera: Camera that sees the scene.

    Returns:
        The results, or None if a string lies outside the workspace of the default cell.
    """
    tier, seed = tier_and_seed
    case = make_case(tier, seed, camera)
    scan = _scan(case)
    if scan is None:
        return None
    request = RecognitionRequest(radius_m=case.scene.radius_m)
    checks: list[ViewCheck] = []
    taken: list[DepthView] = []

    def views_as_needed() -> Iterator[DepthView]:
        for view in scan.views:
            taken.append(view)
            yield view
            if checks and checks[-1].suffices:
                return

    def recognise_some(some: Sequence[DepthView], earlier: Recognition | None) -> Recognition:
        return recognise(some, request, scan.scene, earlier=earlier)

    auto = _result(lambda: recognise_after_each_view(views_as_needed(), recognise_some, checks.append), scan)
    eight = _result(lambda: recognise(scan.views, request, scan.scene), scan)
    return ViewsCase(tier, seed, len(taken), auto, eight)


def run_views_cases(
    tiers: Sequence[str],
    seeds: int,
    jobs: int,
    on_done: Callable[[str], object],
    camera: CameraName = DEFAULT_CAMERA,
) -> Iterator[ViewsCase | None]:
    """Yield the results of all cases, tier by tier and by seed, as `run_views_case` returns them.

    Args:
        tiers: Names of `VIEWS_TIERS`.
        seeds: Number of cases of each tier. Their seeds are 0, 1, ...
        jobs: Number of processes.
        on_done: Called with the tier of each case before its results are yielded.
        camera: Camera that sees the scenes.
    """
    items = [(tier, seed) for tier in tiers for seed in range(seeds)]
    cases = map_in_processes(partial(run_views_case, camera=camera), items, jobs)
    for (tier, _), case in zip(items, cases, strict=True):
        on_done(tier)
        yield case


def summarise_views(cases: Iterable[ViewsCase | None]) -> ViewsSummary:
    """Summarise the results of one tier. Cases outside the workspace do not count."""
    inside = [case for case in cases if case is not None]
    autos, eights = [case.auto for case in inside], [case.eight for case in inside]
    return ViewsSummary(
        scenes=len(inside),
        four_views=sum(case.views == MIN_SUFFICIENT_VIEWS for case in inside),
        mean_views=round(float(np.mean([case.views for case in inside])), 2) if inside else None,
        auto_right=sum(auto.is_right for auto in autos),
        eight_right=sum(eight.is_right for eight in eights),
        auto_silently_wrong=sum(auto.is_silently_wrong for auto in autos),
        eight_silently_wrong=sum(eight.is_silently_wrong for eight in eights),
        auto_mean_mm=_median_mm(auto.score and auto.score.mean_m for auto in autos),
        eight_mean_mm=_median_mm(eight.score and eight.score.mean_m for eight in eights),
        auto_end_mm=_median_mm(auto.score and auto.score.end_m for auto in autos),
        eight_end_mm=_median_mm(eight.score and eight.score.end_m for eight in eights),
    )


def views_row(tier: str, summary: ViewsSummary) -> str:
    """Return the row of one tier in the table."""
    s = summary
    distances_mm = (s.auto_mean_mm, s.eight_mean_mm, s.auto_end_mm, s.eight_end_mm)
    return table_row(
        (
            tier,
            str(s.scenes),
            f"{s.four_views / s.scenes:.0%}" if s.scenes else "-",
            "-" if s.mean_views is None else f"{s.mean_views:.1f}",
            *(str(count) for count in (s.auto_right, s.eight_right, s.auto_silently_wrong, s.eight_silently_wrong)),
            *("-" if value is None else f"{value:.2f} mm" for value in distances_mm),
        )
    )


@dataclass(frozen=True, eq=False)
class _Scan:
    """Views of all viewpoints of a cell, and the truth."""

    views: Sequence[DepthView]
    """Views in the order in which a scan with `auto` takes them."""
    scene: Scene
    """Table and workspace."""
    truth: Mapping[str, Any]
    """Truth document."""


def _scan(case: Case) -> _Scan | None:
    """Simulate the views of the default cell, or return None if a string lies outside its workspace."""
    errors = case.errors.robot_m / PoseErrors().robot_m
    camera = SimulatedCamera.model_validate({"model": case.camera.name, "seed": case.seed, "errors": errors})
    settings = CellSettings(camera=camera).for_views("auto")
    half_m = np.ptp(settings.workspace_m, axis=1)[:2] / 2 - BORDER_M
    if any((np.abs(curve[:, :2]) > half_m).any() for curve in case.scene.curves):
        return None
    world = replace(simulated_world(settings), scene=case.scene, camera=case.camera)
    plan, frames = plan_viewpoints(settings, world.nominal_T_flange_camera, None), FrameSource(world)
    poses = {viewpoint.index: viewpoint.T_base_flange for viewpoint in plan.viewpoints}
    views = [
        View(
            index=index,
            depth=median([frames.render_depth(poses[index]) for _ in range(camera.exposures)]),
            depth_unit_m=world.camera.depth_unit_m,
            K=world.camera.K,
            T_base_flange=poses[index],
            T_flange_camera=world.nominal_T_flange_camera,
            stamp_s=float(number),
        )
        for number, index in enumerate(leg.view for leg in plan.legs if leg.view is not None)
    ]
    return _Scan(views, Scene(settings.workspace_m[2][0], settings.workspace_m), world_truth(world))


def _result(recognition: Callable[[], Recognition], scan: _Scan) -> ViewsResult:
    try:
        model = recognition().model
    except RecognitionError:
        return ViewsResult(None, None)
    return ViewsResult(score(model.to_json(), scan.truth), model.quality.verdict)


def _median_mm(distances_m: Iterable[float | None]) -> float | None:
    """Return the median in millimetres. A scan without a distance does not count."""
    known = [distance for distance in distances_m if distance is not None]
    return round(float(np.median(known)) * 1e3, 4) if known else None
