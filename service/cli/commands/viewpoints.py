"""`pointchain viewpoints`: plan the viewpoints of the cell, and print which are reachable. No device is used."""

import json
import sys
from pathlib import Path

import numpy as np

from cell.config.scan_views import Views
from cell.control.active_calibration import file_in_use, hand_eye_in_use
from cell.control.cell import Cell
from cell.errors import CellError
from cell.planning.viewpoints import ViewpointPlan, require_enough
from service.config.loader import ConfigError, load_config


def plan_viewpoints(config_file: Path | None, views: Views | None, picture: Path | None, as_json: bool) -> int:
    """Plan the viewpoints of the configured cell from its home posture, and print them.

    Args:
        config_file: Configuration of the cell. None: the default one.
        views: Number of viewpoints or `auto`. None: the configured value.
        picture: PNG file to write. None: no picture.
        as_json: Print JSON instead of a table.

    Returns:
        The exit code: 0 if enough viewpoints are reachable, else 1.
    """
    try:
        config = load_config(config_file)
        if file_in_use(config.cell.hand_eye) is not None:
            for warning in hand_eye_in_use(config.cell.hand_eye, None).warnings:
                print(f"pointchain viewpoints: {warning}", file=sys.stderr)
        cell = Cell(config.cell)
        try:
            plan = cell.plan(views)
        finally:
            cell.close()
        if picture is not None:
            from cell.planning.plan_plot import draw_plan

            picture.write_bytes(draw_plan(plan, config.cell))
            print(f"wrote {picture}", file=sys.stderr)
        print(json.dumps(plan.to_json(), allow_nan=False) if as_json else _table(plan, config.scan.min_views))
        require_enough(plan, min(config.scan.min_views, len(plan.viewpoints)))
    except (ConfigError, CellError) as error:
        print(f"pointchain viewpoints: {error}", file=sys.stderr)
        return 1
    except OSError as error:
        print(f"pointchain viewpoints: {picture} cannot be written: {error.strerror}", file=sys.stderr)
        return 1
    return 0


def _table(plan: ViewpointPlan, min_views: int) -> str:
    order = [leg.view for leg in plan.legs if leg.view is not None]
    lines = ["view  order  azimuth  elevation  distance  roll  reached"]
    for v in plan.viewpoints:
        azimuth, elevation, roll = (f"{np.rad2deg(a):.0f}" for a in (v.azimuth_rad, v.elevation_rad, v.roll_rad))
        turn = str(order.index(v.index) + 1) if v.index in order else "-"
        reached = f"no: {v.reason}" if v.reason is not None else f"yes{f', {v.fallback}' if v.fallback else ''}"
        lines.append(
            f"{v.index:>4}  {turn:>5}  {azimuth:>7}  {elevation:>9}  {v.distance_m:>6.3f} m  {roll:>4}  {reached}"
        )
    home = ", ".join(f"{angle:.0f}" for angle in np.rad2deg(plan.home_q_rad))
    lines.append(
        f"{plan.reachable} of {len(plan.viewpoints)} reached, from home ({home}) and back, angles in degrees. The arm "
        f"moves for {plan.duration_s:.1f} s. Planned in {plan.planning_s:.2f} s."
    )
    if plan.early_duration_s is not None and min_views <= len(plan.first):
        lines.append(
            f"If the scan ends after viewpoints {', '.join(map(str, plan.first))}, the arm moves for "
            f"{plan.early_duration_s:.1f} s, with the path home."
        )
    if plan.unseen is not None:
        lines.append(f"Warning: {plan.unseen}.")
    return "\n".join(lines)
