"""The preview of a result: the merged cloud from above with the chains, their direction and their crossings."""

import io
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from recognition.model.chains import Chain
from recognition.model.model import PointChainModel

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SIZE_INCH, DPI = (8.0, 6.0), 100
"""Size of the preview: 800 x 600 pixels."""
MAX_CLOUD_POINTS = 20_000
"""Maximum number of drawn points. More points look the same and take longer."""
GAP_RADII = 2.5
"""Half width of the gap in the under strand at a crossing, in string radii, as in a knot diagram."""


def draw_preview(model: PointChainModel, points: NDArray[np.float64]) -> bytes:
    """Return the preview of a model as a PNG of 800 x 600 pixels.

    The view is from above, with x to the right. The cloud is coloured by height. A chain runs from dark to light, and
    a dot marks its first end. At a crossing the under strand has a gap.

    Args:
        model: The model to draw.
        points: (N, 3) merged cloud, base frame, metres.
    """
    # Figure and Agg without pyplot: there is no shared state, and no display is needed.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=SIZE_INCH, dpi=DPI, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.set(aspect="equal", xlabel="x (m)", ylabel="y (m)", title=_title(model))
    axes.grid(visible=True, color="0.92")
    axes.set_axisbelow(True)
    if len(points):
        drawn = points[:: -(-len(points) // MAX_CLOUD_POINTS)]
        cloud = axes.scatter(drawn[:, 0], drawn[:, 1], c=drawn[:, 2] * 1000, s=1.5, cmap="Greys", rasterized=True)
        figure.colorbar(cloud, label="height (mm)", shrink=0.7)
    for chain in model.chains:
        _draw_chain(axes, chain, model)
    for crossing in model.crossings:
        x, y = crossing.point[:2]
        axes.annotate(
            str(crossing.id),
            (x, y),
            (9, 9),
            textcoords="offset points",
            color="#a00000",
            fontsize=11,
            weight="bold",
        )
    if not model.chains and not len(points):
        axes.text(0.5, 0.5, "no string in view", transform=axes.transAxes, ha="center", va="center", fontsize=14)
    buffer = io.BytesIO()
    canvas.print_png(buffer)
    return buffer.getvalue()


def _draw_chain(axes: "Axes", chain: Chain, model: PointChainModel) -> None:
    from matplotlib.collections import LineCollection

    points, s = chain.points[:, :2], chain.arc_length_m
    if chain.closed:
        points, s = np.vstack([points, points[:1]]), np.append(s, chain.length_m)
    segments = np.stack([points[:-1], points[1:]], axis=1)
    middle = (s[:-1] + s[1:]) / 2
    shown = np.ones(len(segments), dtype=bool)
    for crossing in model.crossings:
        if crossing.under.chain == chain.id:
            shown &= np.abs(middle - crossing.under.s_m) > GAP_RADII * chain.radius_m
    lines = LineCollection(list(segments[shown]), cmap="plasma", linewidths=3.5, capstyle="round")
    lines.set_array(middle[shown])
    lines.set_clim(0.0, max(float(s[-1]), 1e-9))
    axes.add_collection(lines)
    axes.plot(*points[0], "o", color="#0d0887", markersize=8, zorder=3)
    axes.annotate(f"chain {chain.id}", points[0], (8, -12), textcoords="offset points", fontsize=9)
    axes.autoscale_view()


def _title(model: PointChainModel) -> str:
    chains, crossings = len(model.chains), len(model.crossings)
    return (
        f"{chains} chain{'' if chains == 1 else 's'}, {crossings} crossing{'' if crossings == 1 else 's'} "
        f"({model.method}, r = {model.parameters.r * 1000:.3g} mm)"
    )
