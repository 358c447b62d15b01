"""`pointchain import cloud`: point clouds and viewpoints to a recording, with a report on stderr."""

import argparse
import sys
from pathlib import Path

from cell.cloud import CloudRequest, ImportedCloud, import_cloud
from cell.cloud.import_cloud import MERGED
from service.errors import INPUT_ERRORS
from service.interchange.scene_options import given_box, given_radius

COMMAND = "pointchain import cloud"


def import_recording(options: argparse.Namespace) -> int:
    """Import point clouds and return the exit code.

    Args:
        options: Parsed options of `pointchain import cloud`.
    """
    try:
        request = CloudRequest(
            viewpoints_m=options.viewpoint,
            view_property=options.view_property,
            string_radius_m=given_radius(options),
            table_z_m=options.table_z,
            workspace_m=given_box(options),
        )
        imported = import_cloud(options.clouds, options.out, request)
    except INPUT_ERRORS as error:
        print(f"{COMMAND}: {error}", file=sys.stderr)
        return 1
    except OSError as error:
        print(f"{COMMAND}: {options.out} cannot be written: {error.strerror or error}", file=sys.stderr)
        return 1
    _report(imported, options.out)
    return 0


def _report(imported: ImportedCloud, out: Path) -> None:
    width, height = max(imported.sizes)
    points, hidden = sum(imported.points), sum(imported.hidden)
    lines = [
        *imported.notes,
        f"{len(imported.sizes)} virtual views, by {imported.form}: depth images of up to {width}x{height} pixels",
        f"hidden by other points: {hidden / points:.1%} of the points of all views",
        f"rounding: pixels are up to {imported.pitch_m * 1000:.2f} mm wide at the points, depth is in steps of "
        f"{imported.depth_unit_m * 1000:g} mm",
    ]
    if imported.form == MERGED:
        lines.append(
            "a merged file shows the strings only if its clouds are registered and have no noise at the edges of the "
            "strings: use one file for each viewpoint if you have them"
        )
    print("\n".join([*lines, f"wrote {out}"]), file=sys.stderr)
