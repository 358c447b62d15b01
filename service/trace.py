"""One picture a stage, in the manner of the paper's figures: what recognition saw and why it decided as it did."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from recognition.matching import match
from recognition.pipeline import Recognition

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Points = NDArray[np.float64]
Truth = Mapping[str, Any] | None

MM = 1000.0
ZOOM_R = 6.0
"""Half width of the close-up of an intersection, in string radii."""
NORMALS = 1500
"""Normals drawn; more would be a grey mass."""


def write_trace(recognition: Recognition, folder: Path, truth: Truth = None) -> list[Path]:
    """Writes the pictures of `recognition` into `folder`, which is made; their paths in the order of the stages.

    `truth` (JSON of a simulated recording's truth file) adds the true centre lines. Stages that were not reached,
    or that the method does not have, have no picture.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for name, draw in _pictures(recognition):
        figure = Figure(figsize=(9, 7), dpi=110, layout="constrained")
        FigureCanvasAgg(figure)
        draw(figure, recognition, truth)
        written.append(folder / f"{name}.png")
        figure.savefig(written[-1])
    return written


Draw = Callable[["Figure", Recognition, Truth], None]


def _pictures(recognition: Recognition) -> list[tuple[str, Draw]]:
    pictures: list[tuple[str, Draw]] = []
    if recognition.registration is not None:
        pictures.append(("fig04_combined_cloud", _combined_cloud))
    if recognition.centre_line is not None:
        pictures += [("fig06_centre_line", _centre_line), ("fig08_matching", _matching)]
    if recognition.enhanced is not None:
        pictures += [
            ("fig09_thinned", _thinned),
            ("fig10_contribution_rate", _contribution_rate),
            ("fig11_intersection", _intersection),
            ("fig15_enhanced_matching", _enhanced_matching),
        ]
    if recognition.reconstruction is not None:
        pictures.append(("fig16_reconnected", _reconnected))
    if recognition.graph is not None:
        pictures += [("graph1_nodes", _nodes), ("graph2_fragments", _fragments), ("graph3_couples", _couples)]
    return [*pictures, ("fig18_model", _model)]


def _combined_cloud(figure: "Figure", recognition: Recognition, truth: Truth) -> None:
    registration = recognition.registration
    assert registration is not None
    axes = _from_above(figure, "Combined point cloud with normal vectors")
    points, normals = registration.points * MM, registration.normals
    _by_height(figure, axes, points)
    some = slice(None, None, max(len(points) // NORMALS, 1))
    axes.quiver(*points[some, :2].T, *normals[some, :2].T, color="0.35", width=0.0012, scale=60, headwidth=2, zorder=1)
    _true_lines(axes, truth)


def _centre_line(figure: "Figure", recognition: Recognition, truth: Truth) -> None:
    assert recognition.centre_line is not None
    axes = _from_above(figure, "Centre line point cloud")
    _by_height(figure, axes, recognition.centre_line.points * MM)
    _true_lines(axes, truth)


def _matching(figure: "Figure", recognition: Recognition, truth: Truth) -> None:
    assert recognition.centre_line is not None
    points = recognition.centre_line.points
    parameters = recognition.model.parameters
    axes = _from_above(figure, "Matching method alone on the centre line point cloud")
    axes.scatter(*points[:, :2].T * MM, s=1, color="0.8")
    _segments(axes, [points[segment] for segment in match(points, parameters)])
    _true_lines(axes, truth)


def _thinned(figure: "Figure", recognition: Recognition, truth: Truth) -> None:
    assert recognition.thinned is not None
    r_c = recognition.model.parameters.r_c * MM
    axes = _from_above(figure, f"Thinned point cloud (r_c = {r_c:g} mm)")
    _by_height(figure, axes, recognition.thinned * MM)
    _true_lines(axes, truth)


def _contribution_rate(figure: "Figure", recognition: Recognition, truth: Truth) -> None:
    assert recognition.thinned is not None
    assert recognition.enhanced is not None
    parameters = recognition.model.parameters
    axes = _from_above(figure, f"Contribution rate (r_s = {parameters.r_s * MM:g} mm, rho_t = {parameters.rho_t:g})")
    rho = recognition.enhanced.rho
    drawn = axes.scatter(
        *recognition.thinned[:, :2].T * MM,
        c=rho,
        s=4,
        cmap="jet_r",
        vmin=min(rho.min(initial=1.0), 0.6),
        vmax=1,
    )
    figure.colorbar(drawn, label="contribution rate rho", shrink=0.7)
    _true_lines(axes, truth)


def _intersection(figure: "Figure", recognition: Recognition, truth: Truth) -> None:
    assert recognition.thinned is not None
    assert recognition.enhanced is not None
    axes = _from_above(figure, "Points that constitute an intersection")
    inside = recognition.enhanced.in_intersection
    for chosen, colour in ((~inside, "0.7"), (inside, "crimson")):
        axes.scatter(*recognition.thinned[chosen, :2].T * MM, s=3, color=colour)
    _true_lines(axes, truth)


def _enhanced_matching(figure: "Figure", recognition: Recognition, truth: Truth) -> None:
    assert recognition.enhanced is not None
    axes = _from_above(figure, "Enhanced matching method: segments and bifurcation centres")
    _segments(axes, recognition.segments)
    centres = recognition.enhanced.bifurcation_centres * MM
    axes.plot(*centres[:, :2].T, "*", color="crimson", markersize=14, label="bifurcation centre")
    _true_lines(axes, truth)


def _reconnected(figure: "Figure", recognition: Recognition, truth: Truth) -> None:
    assert recognition.reconstruction is not None
    axes = _from_above(figure, "Close ends reconnected")
    _segments(axes, [strand.points for strand in recognition.reconstruction.reconnected])
    _true_lines(axes, truth)


def _nodes(figure: "Figure", recognition: Recognition, truth: Truth) -> None:
    assert recognition.graph is not None
    nodes = recognition.graph.nodes
    axes = _from_above(figure, "Nodes of the centre line with the string's direction through each")
    _by_height(figure, axes, nodes.points * MM)
    axes.quiver(
        *nodes.points[:, :2].T * MM,
        *nodes.directions[:, :2].T,
        pivot="mid",
        color="0.6",
        width=0.0012,
        zorder=1,
        headwidth=0,
        headlength=0,
        headaxislength=0,
    )
    _true_lines(axes, truth)


def _fragments(figure: "Figure", recognition: Recognition, truth: Truth) -> None:
    assert recognition.graph is not None
    axes = _from_above(figure, "Fragments: strands as far as they are seen")
    _segments(axes, [fragment.points for fragment in recognition.graph.fragments])
    _true_lines(axes, truth)


def _couples(figure: "Figure", recognition: Recognition, truth: Truth) -> None:
    assert recognition.graph is not None
    axes = _from_above(figure, "Ends that continue one another")
    for fragment in recognition.graph.fragments:
        axes.plot(*fragment.points[:, :2].T * MM, color="0.7")
    ends = recognition.graph.pairing.ends
    if len(ends.points):  # rings have none
        axes.quiver(*ends.points[:, :2].T * MM, *ends.directions[:, :2].T, width=0.003)
    for couple in recognition.graph.pairing.couples:
        axes.plot(*ends.points[list(couple), :2].T * MM, "o-", color="crimson")
    _true_lines(axes, truth)


def _model(figure: "Figure", recognition: Recognition, truth: Truth) -> None:
    """The chains in space with the cameras, and each crossing from near by."""
    crossings = recognition.model.crossings[:6]
    grid = figure.add_gridspec(max(len(crossings), 1), 4 if crossings else 3)
    space = figure.add_subplot(grid[:, :3], projection="3d")
    space.set_title("Point chain model")
    lines = [chain.points * MM for chain in recognition.model.chains]
    for chain, line in zip(recognition.model.chains, lines, strict=True):
        space.plot(*line.T, ".-", markersize=4, linewidth=1.5, label=f"chain {chain.id}")
    cameras = np.array([target.T_base_camera[:3, 3] for target in recognition.targets]).reshape(-1, 3) * MM
    space.scatter(*cameras.T, marker="^", s=50, color="black", label="viewpoints")
    for curve in (truth or {}).get("curves", []):
        space.plot(*np.asarray(curve).T * MM, color="0.6", linewidth=0.8)
    space.set(xlabel="x (mm)", ylabel="y (mm)", zlabel="z (mm)")
    space.set_aspect("equal")
    space.legend(loc="upper right")
    for row, crossing in enumerate(crossings):
        half = ZOOM_R * recognition.model.parameters.r * MM
        x, y = crossing.point[:2] * MM
        axes = figure.add_subplot(grid[row, 3])
        axes.set(xlim=(x - half, x + half), ylim=(y - half, y + half), aspect="equal", xticks=[], yticks=[])
        axes.set_title(f"crossing {crossing.id}: {crossing.gap_m * MM:.1f} mm apart", fontsize=8)
        for number, line in enumerate(lines):
            axes.plot(*line[:, :2].T, ".-", color=f"C{number}")
        for strand, word in ((crossing.over, "over"), (crossing.under, "under")):
            chain = recognition.model.chains[strand.chain]
            # The label sits where the strand leaves the crossing, so that it is plain which one is meant.
            s = min(strand.s_m + 3 * chain.radius_m, float(chain.arc_length_m[-1]))
            x, y = (float(np.interp(s, chain.arc_length_m, chain.points[:, k])) * MM for k in (0, 1))
            axes.annotate(word, (x, y), fontsize=8, weight="bold" if word == "over" else "normal")
        _true_lines(axes, truth)


def _from_above(figure: "Figure", title: str) -> "Axes":
    axes = figure.add_subplot()
    axes.set(title=title, xlabel="x (mm)", ylabel="y (mm)", aspect="equal")
    return axes


def _by_height(figure: "Figure", axes: "Axes", points_mm: Points) -> None:
    drawn = axes.scatter(*points_mm[:, :2].T, c=points_mm[:, 2], s=2, cmap="viridis")
    figure.colorbar(drawn, label="z (mm)", shrink=0.7)


def _segments(axes: "Axes", segments: Any) -> None:
    for points in segments:
        (line,) = axes.plot(*points[:, :2].T * MM, ".-", markersize=4, linewidth=1)
        axes.plot(*points[[0, -1], :2].T * MM, "o", color=line.get_color(), markersize=7, fillstyle="none")


def _true_lines(axes: "Axes", truth: Truth) -> None:
    for number, curve in enumerate((truth or {}).get("curves", [])):
        axes.plot(
            *np.asarray(curve)[:, :2].T * MM,
            color="black",
            linewidth=0.6,
            label="true line" if number == 0 else None,
        )
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="best")
