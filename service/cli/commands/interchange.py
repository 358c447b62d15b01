"""The commands for files of other programs: `pointchain import` and `export`."""

import argparse
from pathlib import Path

from service.cli.options import Commands
from service.interchange.scene_options import add_scene_options


def add_interchange_commands(commands: Commands) -> None:
    """Add `import` and `export`."""
    imports = commands.add_parser(
        "import", help="recordings from other programs' files: ROS bags, depth images, point clouds"
    )
    kinds = imports.add_subparsers(title="kinds", required=True, metavar="KIND")
    bag = kinds.add_parser(
        "bag",
        help="import a ROS 1 or ROS 2 bag with depth images, CameraInfo and /tf",
        description="Write a recording of a bag: one view per position where the arm stood still, the median of its "
        "images, with the pose from /tf at their time. Topics and frames that are not given are found and printed on "
        "stderr. Needs the extra `bag`.",
    )
    bag.add_argument("bag", type=Path, metavar="BAG", help=".bag file, folder of a ROS 2 bag, or file in it")
    bag.add_argument("out", type=Path, metavar="OUT.mcap", help="recording to write; it must not exist")
    bag.add_argument("--depth-topic", metavar="TOPIC", help="topic of the depth images (the only one)")
    bag.add_argument(
        "--info-topic", metavar="TOPIC", help="topic of their CameraInfo (the one beside the images, else the only one)"
    )
    bag.add_argument(
        "--intensity-topic",
        metavar="TOPIC",
        help="topic of grey images that are aligned with the depth (the first one whose camera is that of the depth)",
    )
    bag.add_argument("--base-frame", metavar="NAME", help="frame of the robot's base (base, else base_link)")
    bag.add_argument("--flange-frame", metavar="NAME", help="frame of the flange (tool0, else flange)")
    bag.add_argument("--camera-frame", metavar="NAME", help="optical frame of the images (the one in their headers)")
    bag.add_argument("--hand-eye", type=Path, metavar="JSON", help="hand-eye calibration (the transform in /tf)")
    bag.add_argument(
        "--depth-unit",
        type=float,
        metavar="M",
        help="metres per count of 16UC1 (0.001); rounding of 32FC1 (0.0001)",
    )
    bag.add_argument(
        "--rectified",
        action="store_true",
        help="the images are rectified, although the topic name does not contain rect",
    )
    add_scene_options(bag)
    bag.set_defaults(run=_import_bag)
    _add_frames(kinds)
    _add_cloud(kinds)

    export = commands.add_parser(
        "export",
        help="write a model as point cloud (.ply), table (.csv) or scene (.mcap)",
        description="Write the chains of a model for other programs: points and edges for Open3D, MeshLab and "
        "CloudCompare (.ply), one row per point (.csv), or scene and model for Foxglove (.mcap).",
    )
    export.add_argument(
        "model", type=Path, metavar="MODEL", help="output of `recognise`, or recording of a live scan; - for stdin"
    )
    export.add_argument("out", type=Path, metavar="OUT", help="file to write (.ply, .csv or .mcap); it must not exist")
    export.set_defaults(run=_export)


def _add_frames(kinds: Commands) -> None:
    frames = kinds.add_parser(
        "frames",
        help="a folder of depth images (16-bit PNG or NPY) with camera matrix and poses",
        description="Write a recording of a folder of depth images: a view for each image, in the order of the "
        "numbers in the file names. The folder also holds the camera matrix (camera.json or K.json) and the poses "
        "(poses.json, or a .json or .txt file beside each image).",
    )
    frames.add_argument("folder", type=Path, metavar="DIR", help="folder with the depth images")
    frames.add_argument("out", type=Path, metavar="OUT.mcap", help="recording to write; it must not exist")
    frames.add_argument(
        "--hand-eye",
        type=Path,
        metavar="JSON",
        help="hand-eye calibration; the poses are then flange poses, T_base_flange (else camera poses, T_base_camera)",
    )
    frames.add_argument(
        "--intrinsics",
        type=float,
        nargs=4,
        metavar=("FX", "FY", "CX", "CY"),
        help="camera matrix in pixels, in place of the folder's file",
    )
    frames.add_argument(
        "--depth-unit",
        type=float,
        metavar="M",
        help="metres per count of integers, or per unit of floats (as in camera.json, else guessed from the table)",
    )
    frames.add_argument(
        "--intensity",
        type=Path,
        metavar="DIR",
        help="folder with an intensity image for each depth image: 8-bit grey PNG of the same name, aligned with it",
    )
    add_scene_options(frames)
    frames.set_defaults(run=_import_frames)


def _add_cloud(kinds: Commands) -> None:
    cloud = kinds.add_parser(
        "cloud",
        help="point clouds (PLY) with the positions that they were taken from",
        description="Write a recording of point clouds in the base frame, in metres. The points that are visible "
        "from each viewpoint become the depth image of a virtual camera there. Give one file for each viewpoint, or "
        "one merged file with several viewpoints.",
    )
    cloud.add_argument("clouds", type=Path, nargs="+", metavar="FILE.ply", help="one file, or one for each viewpoint")
    cloud.add_argument("out", type=Path, metavar="OUT.mcap", help="recording to write; it must not exist")
    cloud.add_argument(
        "--viewpoint",
        type=float,
        nargs=3,
        action="append",
        required=True,
        metavar=("X", "Y", "Z"),
        help="position of the camera in the base frame, metres; repeat it, in the order of the files",
    )
    cloud.add_argument(
        "--view-property", metavar="NAME", help="property of a merged file that numbers the viewpoint of each point"
    )
    add_scene_options(cloud)
    cloud.set_defaults(run=_import_cloud)


def _import_bag(options: argparse.Namespace) -> int:
    from service.interchange.import_bag import import_recording

    return import_recording(options)


def _import_frames(options: argparse.Namespace) -> int:
    from service.interchange.import_frames import import_recording

    return import_recording(options)


def _import_cloud(options: argparse.Namespace) -> int:
    from service.interchange.import_cloud import import_recording

    return import_recording(options)


def _export(options: argparse.Namespace) -> int:
    from service.interchange.export import export

    return export(options.model, options.out)
