"""Conversion of scan rows to their JSON documents."""

from collections import defaultdict
from collections.abc import Sequence
from datetime import UTC, datetime

from service.api.schemas.addresses import SCANS
from service.api.schemas.problem import problem_resource
from service.api.schemas.scans import (
    ScanLinks,
    ScanProgress,
    ScanResource,
    ScanSummary,
    ScanTiming,
    ViewDurations,
    ViewProgress,
    requested_members,
)
from service.states import ACTIVE_STATES, RESULT_STATES
from service.storage.data_folder import HEIGHT_MAP
from service.storage.rows import ScanRow, ViewRow

DURATIONS = ("wait", "connect", "plan", "expected_to_model", "expected_to_home", "to_model", "to_home")
"""Members of the timing that a row has as they are."""


def scan_resource(row: ScanRow, views: Sequence[ViewRow]) -> ScanResource:
    """Return a scan as a document. `views` are the views of this scan."""
    own, elapsed_s = f"{SCANS}/{row.id}", _elapsed(row)
    return ScanResource(
        id=row.id,
        mode=row.mode,
        recording=row.recording,
        source=row.source,
        **requested_members(row.request),
        views=row.views,
        state=row.state,
        final=row.state not in ACTIVE_STATES,
        progress=ScanProgress(
            stage=row.stage,
            fraction=row.fraction,
            views=[ViewProgress(index=view.view, state=view.state, reason=view.reason) for view in views],
            elapsed_s=elapsed_s,
            remaining_s=None if elapsed_s is None else _remaining(row, views, elapsed_s),
        ),
        created_at=row.created_at,
        started_at=row.started_at,
        ended_at=row.ended_at,
        summary=ScanSummary.model_validate(row.summary) if row.summary else None,
        problem=problem_resource(row.failure, own),
        requested_by=row.requested_by,
        kept=row.kept,
        calibration_sha256=row.calibration_sha256,
        simulated=row.simulated,
        timing_s=_timing(row, views),
        links=_links(row, own),
    )


def scan_resources(rows: Sequence[ScanRow], views: Sequence[ViewRow]) -> list[ScanResource]:
    """Return scans as documents. `views` are the views of all of them."""
    of_scan: defaultdict[str, list[ViewRow]] = defaultdict(list)
    for view in views:
        of_scan[view.scan].append(view)
    return [scan_resource(row, of_scan[row.id]) for row in rows]


def _elapsed(row: ScanRow) -> float | None:
    """Return the time since the first move of a live scan that runs, seconds."""
    if row.mode != "live" or row.started_at is None or row.ended_at is not None:
        return None
    started = datetime.fromisoformat(row.started_at)
    return round(max((datetime.now(UTC) - started).total_seconds(), 0.0), 1)


def _remaining(row: ScanRow, views: Sequence[ViewRow], elapsed_s: float) -> float | None:
    """Return the expected time until the model, seconds.

    If the recorded views were late, the rest is expected to be late too. The larger their share of the plan, the nearer
    its delay is to theirs, in proportion.
    """
    timing = row.timing or {}
    expected_s = timing.get("expected_to_model")
    if expected_s is None:
        return None
    taken = [durations.move + durations.settle + durations.exposure for durations in _view_durations(views)]
    planned = timing.get("expected_to_views", [])[: len(taken)]
    planned_s, taken_s = (planned[-1], sum(taken)) if planned else (0.0, 0.0)
    slower = 1.0 + (taken_s - planned_s) / expected_s if expected_s > 0 else 1.0
    return round(max(taken_s + slower * (expected_s - planned_s) - elapsed_s, 0.0), 1)


def _view_durations(views: Sequence[ViewRow]) -> list[ViewDurations]:
    """Return the durations of the recorded views."""
    return [
        ViewDurations(
            index=view.view,
            move=round(view.move_s, 3),
            settle=round(view.settle_s, 3),
            exposure=round(view.exposure_s, 3),
        )
        for view in views
        if view.move_s is not None and view.settle_s is not None and view.exposure_s is not None
    ]


def _timing(row: ScanRow, views: Sequence[ViewRow]) -> ScanTiming:
    timing = row.timing or {}
    return ScanTiming(
        **{name: timing.get(name) for name in DURATIONS},
        views=_view_durations(views),
        recognition=timing.get("recognition", {}),
    )


def _links(row: ScanRow, own: str) -> ScanLinks:
    active, done = row.state in ACTIVE_STATES, row.state in RESULT_STATES
    return ScanLinks(
        self=own,
        events=f"{own}/events",
        cancel=f"{own}/cancel" if active else None,
        reprocess=f"{own}/reprocess" if row.recording and not active else None,
        source=f"{SCANS}/{row.source}" if row.source else None,
        recording=f"{own}/recording" if row.recording else None,
        model=f"{own}/model" if done else None,
        grasps=f"{own}/grasps" if done else None,
        cloud=f"{own}/cloud.ply" if done else None,
        height_map=f"{own}/height-map" if done and HEIGHT_MAP in (row.files or {}) else None,
        preview=f"{own}/preview.png" if done else None,
        thumbnail=f"{own}/thumbnail.png" if done else None,
        views=f"{own}/views" if row.recording or row.mode == "live" else None,
    )
