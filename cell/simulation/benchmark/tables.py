"""Format the results of the benchmark as Markdown tables."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, get_args

from cell.simulation.benchmark.accuracy import Summary
from cell.simulation.benchmark.finding_counts import FindingCounts
from cell.simulation.benchmark.grasp_counts import GraspCounts
from cell.simulation.benchmark.grasps import GraspSummary
from cell.simulation.benchmark.intervals import Interval
from cell.simulation.benchmark.scaling import Growth, Row
from cell.simulation.benchmark.speed import Speed
from recognition.model.trust import Verdict

ACCURACY_COLUMNS = (
    "tier",
    "method",
    "scenes",
    "topology right",
    "95 % interval",
    "mean error",
    "95th percentile",
    "shape error",
    "worst end",
    "cover",
    "confident mistakes",
    "refused",
)
"""Column headings of the accuracy table."""
GRASP_COLUMNS = (
    "tier",
    "grasps",
    "scenes",
    "without grasp",
    "simulated",
    "right string lifted",
    "95 % interval",
    "wrong string",
    "touching",
    "clean by geometry",
    "with robot errors",
    "right string lifted",
    "wrong string",
    "touching",
)
"""Column headings of the table of grasps. The last three are with errors of the robot."""


def accuracy_rows(accuracy: Mapping[str, Mapping[str, Summary]]) -> list[str]:
    """Return the rows of the accuracy table without its head, one for each tier and method."""
    rows = [
        (
            tier,
            method,
            str(s.n),
            _percent(s.topology),
            _interval(s.topology_interval_95),
            *(_mm(value) for value in (s.mean_mm, s.p95_mm, s.shape_mm)),
            _mm(s.end_mm, 1),
            f"{s.cover:.3f}",
            str(s.confident_mistakes),
            str(s.refused),
        )
        for tier, methods in accuracy.items()
        for method, s in methods.items()
    ]
    return [table_row(row) for row in rows]


def grasp_rows(grasps: Mapping[str, Mapping[str, GraspSummary]]) -> list[str]:
    """Return the rows of the table of grasps without its head, one for each tier and selection."""
    rows = [
        (
            tier,
            selection,
            str(s.scenes),
            str(s.without_grasp),
            str(s.simulated),
            _percent(s.good),
            _interval(s.good_interval_95),
            *(_percent(share) for share in (s.wrong_string, s.touching, s.clean)),
            str(s.with_errors),
            *(_percent(s.good_with_errors), _percent(s.wrong_string_with_errors), _percent(s.touching_with_errors)),
        )
        for tier, selections in grasps.items()
        for selection, s in selections.items()
    ]
    return [table_row(row) for row in rows]


def sigma_table(sigma: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the table of the points within two sigma of the truth, with one row for each tier and method."""
    rows = [
        (tier, method, *(cell for part in (s, s["seen"], s["bridged"]) for cell in _share(part)))
        for tier, methods in sigma.items()
        for method, s in methods.items()
    ]
    parts = [cell for name in ("within 2 sigma", "seen", "bridged") for cell in (name, "95 % interval", "points")]
    return table(("tier", "method", *parts), rows)


def findings_table(findings: Mapping[str, Mapping[str, FindingCounts]]) -> str:
    """Return the table of the verdicts and the findings, with one row for each tier and method."""
    rows = [
        (
            tier,
            method,
            *(str(verdicts[verdict]) for verdicts in (counts.right, counts.wrong) for verdict in get_args(Verdict)),
            ", ".join(f"{code}: {count}" for code, count in counts.codes.items()),
        )
        for tier, methods in findings.items()
        for method, counts in methods.items()
    ]
    columns = [f"{kind}: {verdict}" for kind in ("right", "wrong") for verdict in get_args(Verdict)]
    return table(("tier", "method", *columns, "models with each finding"), rows)


def grasps_table(grasps: Mapping[str, GraspCounts]) -> str:
    """Return the table of the grasps by the true geometry, with one row for each tier and kind of object."""
    columns = (
        "tier, objects",
        "scenes",
        "without grasp",
        "grasps",
        "finger on table",
        "on object",
        "on other strand",
        "on gripped strand",
        "palm",
        "off string",
        "best grasp touches",
    )
    rows = [
        (
            name,
            *(
                str(count)
                for count in (
                    c.scenes,
                    c.scenes - c.with_grasps,
                    c.grasps,
                    c.on_table,
                    c.on_object,
                    c.on_string,
                    c.on_gripped,
                    c.by_palm,
                    c.off_string,
                    c.best_touching,
                )
            ),
        )
        for name, c in grasps.items()
    ]
    return table(columns, rows)


def speed_table(speed: Speed) -> str:
    """Return the table of the times and the memory of recognition."""
    return table(
        ("8 views to the model", ""),
        [
            ("640x400", _seconds(speed.views8_640x400_s)),
            ("640x400, literal baseline", _seconds(speed.literal_s)),
            ("literal baseline / ours", f"{speed.ratio:.1f}"),
            ("640x400, after the last view arrived", _seconds(speed.after_last_view_s)),
            ("1280x800", _seconds(speed.views8_1280x800_s)),
            ("1280x800, peak memory beyond imports", f"{speed.peak_rss_mb:.0f} MB"),
        ],
    )


def stages_table(stages: Mapping[str, float]) -> str:
    """Return the table of the times of the stages."""
    return table(("stage, 640x400", "time"), [(stage, _seconds(seconds)) for stage, seconds in stages.items()])


def growth_table(growth: Growth) -> str:
    """Return the table of the growth of the time, with one row for each size of each series."""
    linear = growth.linear()
    series: tuple[tuple[str, str, Sequence[Row]], ...] = (
        ("points", "{:.0f} pixels per view", growth.points),
        ("views", "{:g} views", growth.views),
        ("length", "{:g} m", growth.length),
    )
    rows = [
        (
            unit.format(row.size),
            str(row.points) if row.refused is None else "-",
            f"{row.size_ratio:.1f}",
            "refused" if row.seconds is None else _seconds(row.seconds),
            "-" if row.ratio is None else f"{row.ratio:.1f}",
            "yes" if linear[name] else "NO",
        )
        for name, unit, part in series
        for row in part
    ]
    return table(("input", "string points", "size ratio", "time", "time ratio", "series linear"), rows)


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Format a Markdown table."""
    return "\n".join([table_head(head), *map(table_row, rows)])


def table_head(columns: Sequence[str]) -> str:
    """Format the heading line and the separator line of a Markdown table."""
    return f"{table_row(columns)}\n{table_row(['---'] * len(columns))}"


def table_row(cells: Sequence[str]) -> str:
    """Format one row of a Markdown table."""
    return f"| {' | '.join(cells)} |"


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{share:.1%}"


def _mm(value: float | None, digits: int = 2) -> str:
    return "-" if value is None else f"{value:.{digits}f} mm"


def _seconds(value: float) -> str:
    return f"{value:.3f} s"


def _interval(interval: Interval | None) -> str:
    return "-" if interval is None else f"{interval[0]:.1%} to {interval[1]:.1%}"


def _share(part: Mapping[str, Any]) -> tuple[str, str, str]:
    return _percent(part["within_2_sigma"]), _interval(part["within_2_sigma_interval_95"]), str(part["n_points"])
