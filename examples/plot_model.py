"""Draw a top view of a point chain model: chains, sigma, and over and under at each crossing.

    pointchain recognise knot.mcap > knot.json
    python examples/plot_model.py knot.json knot.png

Each chain has a dot at its first point. At a crossing, the lower strand is interrupted. The colour is one sigma of each
point; a dashed part was seen by no view.
"""

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

MM = 1000.0
GAP_RADII = 1.7
"""Half the length, in string radii, by which the lower strand is interrupted."""
WIDTH_INCH = 8.0
MARGIN_MM = 15.0


def draw(model: Mapping[str, Any]) -> Figure:
    """Return a figure of a model document (schema `pointchain/2`), seen from above."""
    figure = Figure(figsize=(WIDTH_INCH, WIDTH_INCH), layout="constrained")
    axes = figure.add_subplot()
    axes.set(xlabel="x (mm)", ylabel="y (mm)", aspect="equal", title=title(model))
    chains: Sequence[Mapping[str, Any]] = model["chains"]
    sigmas = np.concatenate([[0.0], *(chain["sigma_m"] for chain in chains)]) * MM
    colours = Normalize(0.0, max(float(np.percentile(sigmas, 98)), 0.1))
    lines = [add_chain(axes, chain, model["crossings"], colours) for chain in chains]
    if lines:
        figure.colorbar(lines[0], ax=axes, label="sigma (mm)", shrink=0.7)
        xy = np.vstack([np.array(chain["points"])[:, :2] for chain in chains]) * MM
        (x0, y0), (x1, y1) = xy.min(axis=0) - MARGIN_MM, xy.max(axis=0) + MARGIN_MM
        axes.set(xlim=(x0, x1), ylim=(y0, y1))
        figure.set_figheight(float(np.clip(WIDTH_INCH * 0.8 * (y1 - y0) / (x1 - x0) + 1.2, 3.0, 12.0)))
    for crossing in model["crossings"]:
        add_crossing(axes, crossing)
    return figure


def title(model: Mapping[str, Any]) -> str:
    """Return the title: counts, method, and whether anything is uncertain."""
    quality = model["quality"]
    counts = f"method {model['method']}, chains: {len(model['chains'])}, crossings: {len(model['crossings'])}"
    doubts = sorted({found["code"] for found in quality["findings"] if found["severity"] != "note"})
    return f"{counts}\nverdict: {quality['verdict']}{': ' if doubts else ''}{', '.join(doubts)}"


def add_chain(
    axes: Axes, chain: Mapping[str, Any], crossings: Sequence[Mapping[str, Any]], colours: Normalize
) -> LineCollection:
    """Draw one chain with gaps where it passes under, coloured by sigma; dashed where no view saw it."""
    points, s, sigma, views = (np.array(chain[name]) for name in ("points", "arc_length_m", "sigma_m", "views"))
    if chain["closed"]:
        points, sigma, views = (np.concatenate([values, values[:1]]) for values in (points, sigma, views))
        s = np.append(s, chain["length_m"])
    at = np.union1d(np.linspace(0.0, s[-1], 4 * len(s)), s)
    xy = np.column_stack([np.interp(at, s, points[:, k]) for k in (0, 1)]) * MM
    segments = np.stack([xy[:-1], xy[1:]], axis=1)
    middle = (at[:-1] + at[1:]) / 2
    shown = ~under_another(middle, chain, crossings)
    seen = np.interp(middle, s, views > 0) > 0.5
    value = np.interp(middle, s, sigma) * MM
    drawn = LineCollection(list(segments[shown & seen]), cmap="viridis", norm=colours, linewidths=4.0, capstyle="round")
    drawn.set_array(value[shown & seen])
    axes.add_collection(drawn)
    axes.add_collection(LineCollection(list(segments[shown & ~seen][::2]), colors="0.5", linewidths=2.0))
    axes.plot(*xy[0], "o", color="black", markersize=7)
    axes.annotate(str(chain["id"]), xy[0], xytext=(7, 7), textcoords="offset points", weight="bold")
    for end, place in zip(chain["ends"], xy[[0, -1]], strict=True):
        if end != "free":
            axes.plot(*place, "o", color="crimson", fillstyle="none", markersize=14)
    return drawn


def under_another(
    s: NDArray[np.float64], chain: Mapping[str, Any], crossings: Sequence[Mapping[str, Any]]
) -> NDArray[np.bool_]:
    """Return (N,) whether each arc length `s` (N,) of the chain is where it passes under another strand."""
    hidden = np.zeros(len(s), dtype=bool)
    for crossing in crossings:
        if crossing["under"]["chain"] == chain["id"]:
            apart = np.abs(s - crossing["under"]["s_m"])
            if chain["closed"]:
                apart = np.minimum(apart, chain["length_m"] - apart)
            # A strand that crosses at an acute angle is covered over a longer part.
            half = GAP_RADII * chain["radius_m"] / max(np.sin(crossing["angle_rad"]), 0.3)
            hidden |= apart < half
    return hidden


def add_crossing(axes: Axes, crossing: Mapping[str, Any]) -> None:
    """Write the gap and the confidence beside a crossing, in red if it is uncertain."""
    x, y = (value * MM for value in crossing["point"][:2])
    text = f"{crossing['gap_m'] * MM:.1f} mm"
    certain = crossing["confidence"] >= 0.9
    if not certain:
        text += f"\nconfidence {crossing['confidence']:.2f}"
    axes.annotate(
        text,
        (x, y),
        xytext=(14, 14),
        textcoords="offset points",
        fontsize=9,
        color="black" if certain else "crimson",
        bbox={"boxstyle": "round,pad=0.2", "facecolor": "white", "edgecolor": "0.7", "alpha": 0.9},
        arrowprops={"arrowstyle": "-", "color": "0.5"},
    )


def main() -> None:
    """Read a model and write the picture."""
    parser = argparse.ArgumentParser(description="Draws a top view of a point chain model.")
    parser.add_argument("model", type=Path, help="JSON document, as `pointchain recognise` prints it")
    parser.add_argument("picture", type=Path, help="PNG, SVG or PDF file to write")
    options = parser.parse_args()
    text = options.model.read_text().splitlines()[0]
    model = json.loads(text)
    if "error" in model:
        raise SystemExit(f"{options.model} has no model: {model['error']['detail']}")
    draw(model).savefig(options.picture, dpi=120)


if __name__ == "__main__":
    main()
