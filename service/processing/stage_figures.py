"""Draw one picture of each stage of recognition, in the style of the paper's figures."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from recognition.model.chains import Crossing
from recognition.model.model import PointChainModel
from recognition.result import Recognition

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Points = NDArray[np.float64]
Truth = Mapping[str, Any] | None
Draw = Callable[["Figure", Recognition, Truth], None]

MM = 1000.0
"""Millimetres per metre."""
WIDTH_INCH = 9.0
"""Width of each picture. Its height follows the extent of what it shows."""
ZOOM_R = 6.0
"""Half width of the close-up of a crossing, in string radii."""
LABEL_R = 3.5
"""Distance of the labels "over" and "under" from the crossing, in string radii."""
MAX_CLOSE_UPS = 6
"""Maximum number of crossings with a close-up."""
CLOSE_UPS_PER_COLUMN = 3
"""Number of close-ups in one column."""
MAX_NORMALS = 1500
"""Approximate maximum number of drawn normal vectors. More of them hide the points."""


def write_trace(recognition: Recognition, folder: Path, truth: Truth = None) -> list[Path]:
    """Write one picture for each stage of `recognition` into `folder`.

    The files are numbered in the order of the pipeline: `01_target_cloud.png`, `02_registered_cloud.png` and so on.
    A stage that the method does not have, or that was not reached, has no picture. Pictures that an earlier call
    wrote into `folder` are removed first, so that the folder shows one recognition.

    Args:
        recognition: The result of `recognise`.
        folder: Folder for the pictures. It is created if it does not exist.
        truth: Content of the truth file of a simulated recording. Its true centre lines are drawn too.

    Returns:
        Paths of the pictures, in the order of the pipeline.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for path in folder.glob("[0-9][0-9]_*.png"):
        if path.stem[3:] in STAGE_PICTURES:
            path.unlink()
    written = []
    for number, (name, figure) in enumerate(stage_figures(recognition, truth), start=1):
        written.append(folder / f"{number:02}_{name}.png")
        figure.savefig(written[-1])
    return written


def stage_figures(recognition: Recognition, truth: Truth = None) -> Iterator[tuple[str, "Figure"]]:
    """Yield the name and the figure of each stage, in the order of the pipeline."""
    # Figure and Agg without pyplot: there is no shared state, and no display is needed.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    for name in _reached(recognition):
        figure = Figure(figsize=(WIDTH_INCH, 7), dpi=110, layout="constrained")
        FigureCanvasAgg(figure)
        STAGE_PICTURES[name](figure, recognition, truth)
        yield name, figure


def _reached(recognition: Recognition) -> list[str]:
    """Return the names of the pictures that this recognition has."""
    names = ["target_cloud"]
    if recognition.registration is not None:
        names.append("registered_cloud")
    if recognition.stages.centre_line is not None:
        names.append("centre_line")
    if recognition.stages.enhanced is not None:
        names += ["thinned_cloud", "contribution_rate", "intersections"]
    if recognition.stages.centre_line is not None and recognition.model.method != "graph":
        names.append("segments")
    if recognition.stages.reconstruction is not None:
        names.append("reconnected")
    if recognition.stages.graph is not None:
        names += ["nodes", "fragments", "paired_ends"]
    if recognition.stages.refinement is not None:
        names.append("tube_fit")
    return [*names, "model"]


def _target_cloud(figure: "Figure", recognition: Recognition, truth: Truth) -> None:
    axes = _from_above(figure, "Target point cloud of each view, before registration")
    for target in sorted(recognition.targets, key=lambda target: target.view):
        axes.scatter(*target.points[:, :2].T * MM, s=1, label=f"view {target.view}")
    _finish(figure, axes, truth)


def _registered_cloud(figure: "Figure", recognition: Recognition, truth: Truth) -> None:
    registration = recognition.registration
    assert registration is not None
    axes = _from_above(figure, "Registered point cloud with normal vectors")
    points, normals = registration.points * MM, registration.normals
    _by_height(figure, axes, points)
    some = slice(None, None, max(len(points) // MAX_NORMALS, 1))
    axes.quiver(*points[some, :2].T, *normals[some, :2].T, color="0.35", width=0.0012, scale=60, headwidth=2, zorder=1)
    _finish(figure, axes, truth)


def _centre_line(figure: "Figure", recognition: Recognition, truth: Truth) -> None:
    assert recognition.stages.centre_line is not None
    axes = _from_above(figure, "Centre line point cloud")
    _by_height(figure, axes, recognition.stages.centre_line.points * MM)
    _finish(figure, axes, truth)


def _thinned_cloud(figure: "Figure", recognition: Recognition, truth: Truth) -> None:
    assert recognition.stages.thinned is not None
    r_c = recognition.model.parameters.r_c * MM
    axes = _from_above(figure, f"Thinned point cloud (r_c = {r_c:.2f} mm)")
    _by_height(figure, axes, recognition.stages.thinned * MM)
    _finish(figure, axes, truth)


def _contribution_rate(figure: "Figure", recognition: Recognition, truth: Truth) -> None:
    assert recognition.stages.thinned is not None
    assert recognition.stages.enhanced is not None
    parameters = recognition.model.parameters
    axes = _from_above(figure, f"Contribution rate (r_s = {parameters.r_s * MM:.2f} mm, rho_t = {parameters.rho_t:g})")
    rho = recognition.stages.enhanced.rho
    drawn = axes.scatter(
        *recognition.stages.thinned[:, :2].T * MM,
        c=rho,
        s=4,
        cmap="jet_r",
        vmin=min(rho.min(initial=1.0), 0.6),
        vmax=1,
    )
    figure.colorbar(drawn, label="contribution rate rho", shrink=0.7)
    _finish(figure, axes, truth)


def _intersections(figure: "Figure", recognition: Recognition, truth: Truth) -> None:
    assert recognition.stages.thinned is not None
    assert recognition.stages.enhanced is not None
    axes = _from_above(figure, "Points that belong to an intersection")
    inside = recognition.stages.enhanced.in_intersection
    for chosen, colour, label in ((~inside, "0.7", None), (inside, "crimson", "in an intersection")):
        axes.scatter(*recognition.stages.thinned[chosen, :2].T * MM, s=3, color=colour, label=label)
    _finish(figure, axes, truth)


def _segments(figure: "Figure", recognition: Recognition, truth: Truth) -> None:
    enhanced = recognition.stages.enhanced
    axes = _from_above(figure, "Linked segments" if enhanced is None else "Linked segments and bifurcation centres")
    _lines(axes, recognition.stages.segments)
    if enhanced is not None and len(enhanced.bifurcation_centres):
        centres = enhanced.bifurcation_centres * MM
        axes.plot(*centres[:, :2].T, "*", color="crimson", markersize=14, label="bifurcation centre")
    _finish(figure, axes, truth)


def _reconnected(figure: "Figure", recognition: Recognition, truth: Truth) -> None:
    assert recognition.stages.reconstruction is not None
    axes = _from_above(figure, "Segments with close ends reconnected")
    _lines(axes, [strand.points for strand in recognition.stages.reconstruction.reconnected])
    _finish(figure, axes, truth)


def _nodes(figure: "Figure", recognition: Recognition, truth: Truth) -> None:
    assert recognition.stages.graph is not None
    nodes = recognition.stages.graph.nodes
    axes = _from_above(figure, "Nodes of the centre line and the direction of the string at each")
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
    _finish(figure, axes, truth)


def _fragments(figure: "Figure", recognition: Recognition, truth: Truth) -> None:
    assert recognition.stages.graph is not None
    axes = _from_above(figure, "Fragments: the visible parts of the strands")
    _lines(axes, [fragment.points for fragment in recognition.stages.graph.fragments])
    _finish(figure, axes, truth)


def _paired_ends(figure: "Figure", recognition: Recognition, truth: Truth) -> None:
    assert recognition.stages.graph is not None
    axes = _from_above(figure, "Ends of the fragments, and the pairs that are joined")
    for number, fragment in enumerate(recognition.stages.graph.fragments):
        axes.plot(*fragment.points[:, :2].T * MM, color="0.7", label=None if number else "fragment")
    ends = recognition.stages.graph.pairing.ends
    if len(ends.points):  # a ring has no ends
        axes.quiver(*ends.points[:, :2].T * MM, *ends.directions[:, :2].T, width=0.003)
        axes.plot([], [], "k>", label="end and its direction")
    for number, pair in enumerate(recognition.stages.graph.pairing.pairs):
        line = ends.points[list(pair), :2].T * MM
        axes.plot(*line, "o-", color="crimson", label=None if number else "joined pair")
    _finish(figure, axes, truth)


def _tube_fit(figure: "Figure", recognition: Recognition, truth: Truth) -> None:
    registration, refinement = recognition.registration, recognition.stages.refinement
    assert registration is not None
    assert refinement is not None
    scatter_mm = refinement.scatter_m * MM
    axes = _from_above(figure, f"Tubes fitted to the surface (scatter of the surface {scatter_mm:.2f} mm)")
    for number, strand in enumerate(refinement.strands):
        surface = registration.points[refinement.strand_of_point == number, :2]
        axes.scatter(*surface.T * MM, s=1, color=f"C{number}", alpha=0.4)
        line = strand.points[:, :2].T * MM
        axes.plot(*line, ".-", color=f"C{number}", label=f"strand {number}, r = {strand.radius_m * MM:.2f} mm")
    others = registration.points[refinement.strand_of_point < 0, :2]
    if len(others):
        axes.scatter(*others.T * MM, s=1, color="0.7", label="on no tube")
    _finish(figure, axes, truth)


def _model(figure: "Figure", recognition: Recognition, truth: Truth) -> None:
    """Draw the chains in space with the viewpoints, and a close-up of each crossing."""
    model = recognition.model
    crossings = model.crossings[:MAX_CLOSE_UPS]
    columns = -(-len(crossings) // CLOSE_UPS_PER_COLUMN)
    overview, *close_ups = figure.subfigures(1, 1 + columns, width_ratios=[3.4, *[1.0] * columns], squeeze=False)[0]
    some = "" if len(crossings) == len(model.crossings) else f" (close-ups of {len(crossings)} of its crossings)"
    overview.suptitle(f"Point chain model{some}")
    space: Any = overview.add_subplot(projection="3d")
    for chain in model.chains:
        space.plot(*chain.points.T * MM, ".-", markersize=4, linewidth=1.5, label=f"chain {chain.id}")
    cameras = np.array([target.T_base_camera[:3, 3] for target in recognition.targets]).reshape(-1, 3) * MM
    space.scatter(*cameras.T, marker="^", s=50, color="black", label="viewpoints")
    for number, curve in enumerate((truth or {}).get("curves", [])):
        line = np.asarray(curve).T * MM
        space.plot(*line, color="black", linewidth=0.6, label=None if number else "true line")
    for axis, label in ((space.xaxis, "x (mm)"), (space.yaxis, "y (mm)"), (space.zaxis, "z (mm)")):
        axis.set_label_text(label)
        axis.labelpad = 14
        axis.get_major_locator().set_params(nbins=5)
    space.set_aspect("equal")
    # The layout does not reserve room for the labels of axes in space.
    space.set_box_aspect(None, zoom=0.85)
    overview.legend(loc="outside lower center", ncols=4)
    for number, part in enumerate(close_ups):
        shown = crossings[number * CLOSE_UPS_PER_COLUMN :][:CLOSE_UPS_PER_COLUMN]
        for row, crossing in enumerate(shown):
            _close_up(part.add_subplot(len(shown), 1, row + 1), crossing, model, truth)


def _close_up(axes: "Axes", crossing: Crossing, model: PointChainModel, truth: Truth) -> None:
    """Draw one crossing from above, with the labels "over" and "under" at its strands."""
    half = ZOOM_R * model.parameters.r * MM
    x, y = crossing.point[:2] * MM
    axes.set(xlim=(x - half, x + half), ylim=(y - half, y + half), aspect="equal", xticks=[], yticks=[])
    axes.set_title(f"crossing {crossing.id}:\n{crossing.gap_m * MM:.1f} mm apart", fontsize=8)
    for number, chain in enumerate(model.chains):
        axes.plot(*chain.points[:, :2].T * MM, ".-", color=f"C{number}")
    _true_lines(axes, truth)

    def beside(strand: Any, side: int) -> Points:
        chain = model.chains[strand.chain]
        s = np.clip(strand.s_m + side * LABEL_R * model.parameters.r, 0.0, chain.arc_length_m[-1])
        return np.array([np.interp(s, chain.arc_length_m, chain.points[:, k]) for k in (0, 1)]) * MM

    over = beside(crossing.over, 1)
    # The label "under" goes to the side that is farther from the label "over".
    under = max((beside(crossing.under, side) for side in (1, -1)), key=lambda at: float(np.linalg.norm(at - over)))
    for word, at in (("over", over), ("under", under)):
        weight = "bold" if word == "over" else "normal"
        box = {"boxstyle": "round,pad=0.15", "facecolor": "white", "edgecolor": "0.7", "linewidth": 0.5}
        axes.text(float(at[0]), float(at[1]), word, fontsize=8, weight=weight, ha="center", va="center", bbox=box)


STAGE_PICTURES: dict[str, Draw] = {
    "target_cloud": _target_cloud,
    "registered_cloud": _registered_cloud,
    "centre_line": _centre_line,
    "thinned_cloud": _thinned_cloud,
    "contribution_rate": _contribution_rate,
    "intersections": _intersections,
    "segments": _segments,
    "reconnected": _reconnected,
    "nodes": _nodes,
    "fragments": _fragments,
    "paired_ends": _paired_ends,
    "tube_fit": _tube_fit,
    "model": _model,
}
"""Functions that draw the pictures, by the name of the picture."""


def _from_above(figure: "Figure", title: str) -> "Axes":
    axes = figure.add_subplot()
    axes.set(title=title, xlabel="x (mm)", ylabel="y (mm)", aspect="equal")
    return axes


def _by_height(figure: "Figure", axes: "Axes", points_mm: Points) -> None:
    drawn = axes.scatter(*points_mm[:, :2].T, c=points_mm[:, 2], s=2, cmap="viridis")
    figure.colorbar(drawn, label="z (mm)", shrink=0.7)


def _lines(axes: "Axes", lines: Sequence[Points]) -> None:
    """Draw each line in its own colour, with a circle at both ends."""
    for points in lines:
        (line,) = axes.plot(*points[:, :2].T * MM, ".-", markersize=4, linewidth=1)
        axes.plot(*points[[0, -1], :2].T * MM, "o", color=line.get_color(), markersize=7, fillstyle="none")


def _true_lines(axes: "Axes", truth: Truth) -> None:
    for number, curve in enumerate((truth or {}).get("curves", [])):
        line = np.asarray(curve)[:, :2].T * MM
        axes.plot(*line, color="black", linewidth=0.6, label=None if number else "true line")


def _finish(figure: "Figure", axes: "Axes", truth: Truth) -> None:
    """Add the true lines, and a legend of everything that has a label below the axes."""
    _true_lines(axes, truth)
    width, height = np.ptp(axes.get_xlim()), np.ptp(axes.get_ylim())
    figure.set_figheight(float(np.clip(WIDTH_INCH * 0.8 * height / width + 2.0, 4.0, 9.0)))
    handles, labels = axes.get_legend_handles_labels()
    if handles:
        legend = figure.legend(handles, labels, loc="outside lower center", ncols=min(len(labels), 5))
        handle: Any
        for handle in legend.legend_handles:
            if hasattr(handle, "set_sizes"):  # dots of one pixel would be invisible
                handle.set_sizes([20.0])
