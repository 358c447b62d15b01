"""Picture of a plan of viewpoints."""

import io
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.transforms import inverse, transform_points
from cell.config.arm_models import BASE_RADIUS_M
from cell.config.camera_optics import CameraOptics
from cell.config.cell_config import CellSettings
from cell.kinematics.collision import CollisionModel, collision_model
from cell.kinematics.ur_kinematics import forward, link_frames
from cell.planning.viewpoints import Viewpoint, ViewpointPlan

_FRUSTUM_M = 0.10
"""Drawn length of a camera's frustum."""
_STEPS = 24
"""Number of flange positions that are drawn between two waypoints."""
_SKIPPED = "#c0392b"


@dataclass(frozen=True)
class _Panel:
    """A 3D drawing, or a drawing from above."""

    axes: Any
    dimensions: int

    def line(self, points: NDArray[np.float64], **how: Any) -> None:
        self.axes.plot(*points[:, : self.dimensions].T, **how)

    def text(self, position: NDArray[np.float64], label_text: str, **how: Any) -> None:
        self.axes.text(*position[: self.dimensions], label_text, **how)


def draw_plan(plan: ViewpointPlan, settings: CellSettings) -> bytes:
    """Draw a plan from the side and from above, as PNG.

    The picture shows the workspace, the arm, the cameras with index and order, and the path of the flange. Skipped
    viewpoints are red. The part of the table that too few views show is hatched.

    Args:
        plan: Plan of a scan or a calibration.
        settings: Settings of the cell.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

    order = [leg.view for leg in plan.legs if leg.view is not None]
    colours = ScalarMappable(Normalize(0, max(len(order) - 1, 1)), "viridis")
    figure = Figure(figsize=(14, 7.5))
    FigureCanvasAgg(figure)
    space: Any = figure.add_axes((0.0, 0.04, 0.52, 0.92), projection="3d")
    space.set_proj_type("ortho")
    space.view_init(elev=22, azim=-60)
    space.set_zlabel("z (m)")
    flat: Any = figure.add_axes((0.62, 0.1, 0.36, 0.82))
    flat.grid(color="0.9")
    flat.use_sticky_edges = False
    any_view = plan.viewpoints[0]
    parts = collision_model(settings, inverse(any_view.T_base_flange) @ any_view.T_base_camera)
    optics = settings.camera.optics
    for panel in (_Panel(space, 3), _Panel(flat, 2)):
        _draw_room(panel, settings)
        _draw_unobserved(panel, plan, settings.mounting.table_z_m)
        _draw_path(panel, plan, settings)
        _draw_arm(panel, parts, plan.home_q_rad, "0.4", 5.0)
        for viewpoint in plan.viewpoints:
            number = order.index(viewpoint.index) if viewpoint.index in order else None
            colour = _SKIPPED if number is None else colours.to_rgba(np.array(number))
            _draw_camera(panel, viewpoint, optics, colour, number)
            if viewpoint.q_rad is not None and number in (0, len(order) // 2):
                _draw_arm(panel, parts, viewpoint.q_rad, colour, 2.5)
        panel.axes.set_aspect("equal")
        panel.axes.set_xlabel("x (m)")
        panel.axes.set_ylabel("y (m)")
    space.set_box_aspect(None, zoom=1.15)
    flat.set_title("from above", fontsize=10)
    figure.suptitle(
        f"{settings.arm.model}: {plan.reachable} of {len(plan.viewpoints)} viewpoints, "
        f"{plan.duration_s:.1f} s of motion. "
        "Bold: the viewpoint's index, and when it is taken; grey: home; orange: the workspace"
    )
    notes = [f"{v.index} is not reached: {v.reason}" for v in plan.viewpoints if v.q_rad is None]
    if plan.unseen is not None:
        notes.append(f"Hatched: {plan.unseen}")
    figure.text(0.02, 0.01, "\n".join(notes), fontsize=9, color=_SKIPPED, va="bottom")
    target = io.BytesIO()
    figure.savefig(target, format="png", dpi=90)
    return target.getvalue()


def _draw_room(panel: _Panel, settings: CellSettings) -> None:
    (x0, x1), (y0, y1), (z0, z1) = settings.workspace_m
    _draw_box(panel, np.array([(x0, y0, z0), (x1, y1, z1)]), "tab:orange")
    for box in settings.mounting.obstacles_m:
        _draw_box(panel, np.array(box), "tab:red")
    turn = np.linspace(0, 2 * np.pi, 40)
    panel.line(BASE_RADIUS_M[settings.arm.model] * np.column_stack([np.cos(turn), np.sin(turn), 0 * turn]), color="0.2")
    panel.text(np.array([0.0, -0.09, 0.0]), "base", fontsize=9, ha="center", va="top")


def _draw_unobserved(panel: _Panel, plan: ViewpointPlan, table_z_m: float) -> None:
    """Hatch the part of the table that too few views show."""
    if plan.unseen is None:
        return
    coverage = plan.coverage
    # the middles of the grid cells, and the rim
    sides = zip((coverage.x_m, coverage.y_m), coverage.view_count.shape, strict=True)
    x, y = (np.linspace(*side, 2 * count + 1)[[0, *range(1, 2 * count, 2), -1]] for side, count in sides)
    missing = np.pad(np.where(coverage.is_covered, 0.0, 1.0), 1, mode="edge").T
    if panel.dimensions == 3:
        panel.axes.contourf(x, y, missing, levels=[0.5, 1.5], colors=[_SKIPPED], alpha=0.25, zdir="z", offset=table_z_m)
    else:
        panel.axes.contourf(x, y, missing, levels=[0.5, 1.5], colors=["none"], hatches=["///"])
        panel.axes.contourf(x, y, missing, levels=[0.5, 1.5], colors=[_SKIPPED], alpha=0.15)


def _draw_box(panel: _Panel, corners: NDArray[np.float64], colour: str) -> None:
    unit = np.array([(0, 0), (1, 0), (1, 1), (0, 1), (0, 0)])
    low, size = corners.min(axis=0), np.ptp(corners, axis=0)
    for z in (0, 1):
        panel.line(low + np.column_stack([unit, np.full(5, z)]) * size, color=colour, linewidth=1.2)
    for x, y in unit[:4]:
        panel.line(low + np.array([(x, y, 0), (x, y, 1)]) * size, color=colour, linewidth=1.2)


def _draw_arm(panel: _Panel, parts: CollisionModel, q_rad: NDArray[np.float64], colour: Any, width: float) -> None:
    # the axes of the capsules of the collision check, which follow the links
    frames = link_frames(parts.model, q_rad)
    line = [
        transform_points(frames[frame], end[None])[0]
        for pair, ends in zip(parts.part_frames[:-1], parts.part_ends[:-1], strict=True)
        for frame, end in zip(pair, ends, strict=True)
    ]
    panel.line(np.array(line), color=colour, linewidth=width, alpha=0.75, solid_joinstyle="round")


def _draw_path(panel: _Panel, plan: ViewpointPlan, settings: CellSettings) -> None:
    q_rad, path = plan.start_q_rad, []
    for leg in plan.legs:
        for q in leg.waypoints_rad:
            path += [forward(settings.arm.model, q_rad + share * (q - q_rad)) for share in np.linspace(0, 1, _STEPS)]
            q_rad = q
    panel.line(np.array(path)[:, :3, 3], color="0.55", linewidth=0.9, linestyle=":")


def _draw_camera(panel: _Panel, viewpoint: Viewpoint, optics: CameraOptics, colour: Any, number: int | None) -> None:
    from matplotlib.patheffects import withStroke

    corners = np.array([(0, 0), (optics.width, 0), (optics.width, optics.height), (0, optics.height)])
    rays = np.column_stack([corners, np.ones(4)]) @ np.linalg.inv(optics.K).T
    rim = transform_points(viewpoint.T_base_camera, _FRUSTUM_M * rays)
    eye = viewpoint.T_base_camera[:3, 3]
    lines = [rim[0], rim[1], rim[2], rim[3], rim[0], eye, rim[1], rim[2], eye, rim[3]]
    panel.line(np.array(lines), color=colour, linewidth=1.3, linestyle="--" if number is None else "-")
    label = f" $\\bf{{{viewpoint.index}}}$" + ("" if number is None else f" {_ordinal(number + 1)}")
    # the outline keeps the text legible on the lines
    outline = [withStroke(linewidth=3, foreground="white")]
    panel.text(eye, label, color=_SKIPPED if number is None else "black", fontsize=12, path_effects=outline, zorder=9)


def _ordinal(number: int) -> str:
    last = 0 if number % 100 in (11, 12, 13) else number % 10
    return f"{number}{ {1: 'st', 2: 'nd', 3: 'rd'}.get(last, 'th') }"
