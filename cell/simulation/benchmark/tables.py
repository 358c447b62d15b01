"""The benchmark's results as Markdown tables."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from cell.simulation.benchmark.accuracy import Summary
from cell.simulation.benchmark.growth import Growth, Row
from cell.simulation.benchmark.speed import Speed


def accuracy_table(accuracy: Mapping[str, Mapping[str, Summary]]) -> str:
    """A row a tier and method."""
    rows = [
        (
            tier,
            method,
            str(s.n),
            _percent(s.topology),
            *(_mm(value) for value in (s.mean_mm, s.p95_mm, s.shape_mm)),
            _mm(s.end_mm, 1),
            f"{s.cover:.3f}",
            str(s.confident_mistakes),
            str(s.refused),
        )
        for tier, methods in accuracy.items()
        for method, s in methods.items()
    ]
    head = ("tier", "method", "scenes", "topology right", "mean error", "95 %", "shape error", "worst end", "cover")
    return table((*head, "confident mistakes", "refused"), rows)


def sigma_table(sigma: Mapping[str, Mapping[str, Any]]) -> str:
    """A row a tier and method: the share of points within two sigma of the truth."""
    rows = [
        (tier, method, *(cell for part in (s, s["seen"], s["bridged"]) for cell in _share(part)))
        for tier, methods in sigma.items()
        for method, s in methods.items()
    ]
    return table(("tier", "method", "within 2 sigma", "points", "seen", "points", "bridged", "points"), rows)


def speed_table(speed: Speed) -> str:
    """A row a figure."""
    return table(
        ("8 views to the model", ""),
        [
            ("640x400", _seconds(speed.views8_640x400_s)),
            ("640x400, literal baseline", _seconds(speed.literal_s)),
            ("literal baseline / ours", f"{speed.ratio:.1f}"),
            ("640x400, from the last view's arrival", _seconds(speed.after_last_view_s)),
            ("1280x800", _seconds(speed.views8_1280x800_s)),
            ("1280x800, peak memory beyond imports", f"{speed.peak_rss_mb:.0f} MB"),
        ],
    )


def stages_table(stages: Mapping[str, float]) -> str:
    """A row a stage."""
    return table(("stage, 640x400", "time"), [(stage, _seconds(seconds)) for stage, seconds in stages.items()])


def growth_table(growth: Growth) -> str:
    """A row a size of every series."""
    linear = growth.linear()
    series: tuple[tuple[str, str, Sequence[Row]], ...] = (
        ("points", "{:.0f} pixels a view", growth.points),
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
    """A Markdown table."""
    return "\n".join(f"| {' | '.join(row)} |" for row in [head, ["---"] * len(head), *rows])


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{share:.1%}"


def _mm(value: float | None, digits: int = 2) -> str:
    return "-" if value is None else f"{value:.{digits}f} mm"


def _seconds(value: float) -> str:
    return f"{value:.3f} s"


def _share(part: Mapping[str, Any]) -> tuple[str, str]:
    return _percent(part["within_2_sigma"]), str(part["n_points"])
