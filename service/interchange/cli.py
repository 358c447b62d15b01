"""The commands that are about other programs' files: `pointchain import` and `export`."""

import argparse
from pathlib import Path

BOX = ("X0", "X1", "Y0", "Y1", "Z0", "Z1")


def add_interchange_commands(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Adds `import` and `export`."""
    imports = commands.add_parser("import", help="recordings from other programs' files: ROS bags")
    kinds = imports.add_subparsers(title="kinds", required=True, metavar="KIND")
    bag = kinds.add_parser(
        "bag",
        help="a ROS 1 or ROS 2 bag: depth images, their CameraInfo, and /tf",
        description="Writes a recording of a bag: a view for each place where the arm stood still, the median of the "
        "images there, with the pose that /tf tells at their stamp. What is not told is found, and said on stderr. "
        "Needs the package's extra `bag`.",
    )
    bag.add_argument("bag", type=Path, metavar="BAG", help="a .bag file, or the folder of a ROS 2 bag, or its file")
    bag.add_argument("out", type=Path, metavar="OUT.mcap", help="recording to write; it must not exist")
    bag.add_argument("--depth-topic", metavar="TOPIC", help="of the depth images (the only one)")
    bag.add_argument("--info-topic", metavar="TOPIC", help="their CameraInfo (beside the images, else the only one)")
    bag.add_argument("--base-frame", metavar="NAME", help="the robot's base (base, else base_link)")
    bag.add_argument("--flange-frame", metavar="NAME", help="its flange (tool0, else flange)")
    bag.add_argument(
        "--camera-frame", metavar="NAME", help="the optical frame of the images (as their headers have it)"
    )
    bag.add_argument("--hand-eye", type=Path, metavar="JSON", help="where the camera sits on the flange (/tf's)")
    bag.add_argument(
        "--depth-unit",
        type=float,
        metavar="M",
        help="metres a count of 16UC1 (0.001); what 32FC1 is rounded to (0.0001)",
    )
    bag.add_argument("--rectified", action="store_true", help="the images are, though their topic is not named rect")
    bag.add_argument("--radius", type=float, metavar="M", help="of the string, to be kept in the recording")
    bag.add_argument("--table-z", type=float, default=0.0, metavar="M", help="height of the table (%(default)s)")
    bag.add_argument(
        "--workspace", type=float, nargs=6, metavar=BOX, help="box in the base frame to look at, metres (everything)"
    )
    bag.set_defaults(run=_import_bag)

    export = commands.add_parser(
        "export",
        help="a model as a point cloud (.ply), table (.csv) or scene (.mcap)",
        description="Writes the chains of a model for other programs: points and edges for Open3D, MeshLab and "
        "CloudCompare (.ply), a row for each point (.csv), or the scene and the model for Foxglove (.mcap).",
    )
    export.add_argument(
        "model", type=Path, metavar="MODEL", help="what `recognise` prints, or a live scan's recording; - for stdin"
    )
    export.add_argument("out", type=Path, metavar="OUT", help="file to write (.ply, .csv or .mcap); it must not exist")
    export.set_defaults(run=_export)


def _import_bag(options: argparse.Namespace) -> int:
    from service.interchange.import_bag import import_recording

    return import_recording(options)


def _export(options: argparse.Namespace) -> int:
    from service.interchange.export import export

    return export(options.model, options.out)
