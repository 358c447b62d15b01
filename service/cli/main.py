"""Entry point of the command line. Results go to stdout; progress, questions and errors go to stderr.

Each command imports its modules when it runs, so that `pointchain --help` starts fast.
"""

import argparse
import sys
from collections.abc import Sequence
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

from cell.config.camera_names import CAMERA_NAMES, DEFAULT_CAMERA, is_preset_path
from service.cli.calibrate.parser import add_calibrate_commands
from service.cli.commands.audit import add_audit_command
from service.cli.commands.batch import add_batch_commands
from service.cli.commands.camera_profile import add_camera_profile_command
from service.cli.commands.cell import add_cell_commands
from service.cli.commands.doctor import add_doctor_command
from service.cli.commands.interchange import add_interchange_commands
from service.cli.commands.tokens import add_token_commands
from service.cli.options import add_json_option


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        arguments: Command and its arguments. None: those of this process.

    Returns:
        The exit code: 0 for success, 1 for a failure, 2 for wrong arguments, 130 after Ctrl-C.
    """
    options = _parser().parse_args(arguments)
    try:
        return options.run(options)
    except KeyboardInterrupt:
        print("stopped", file=sys.stderr)
        from service.signals import INTERRUPTED_EXIT_CODE  # here, because its module loads asyncio

        return INTERRUPTED_EXIT_CODE
    except BrokenPipeError:
        # the reader of stdout is gone; closing stderr avoids a second error at exit
        sys.stderr.close()
        return 1


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="pointchain",
        description="Recognise strings, cables and ropes as ordered 3D point chains, with a depth camera on a robot "
        "arm.",
    )
    parser.add_argument("--version", action="version", version=f"pointchain {version('pointchain')}")
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")

    add_batch_commands(commands)
    add_cell_commands(commands)
    add_calibrate_commands(commands)
    add_interchange_commands(commands)
    add_camera_profile_command(commands)

    simulate = commands.add_parser(
        "simulate",
        help="make a recording of a simulated scene, with its ground truth",
        description="Write a simulated recording and, beside it, OUT.truth.json with the true centre lines and "
        "crossings. The same arguments give the same content.",
    )
    simulate.add_argument("out", type=Path, metavar="OUT.mcap", help="file to write; it must not exist")
    simulate.add_argument(
        "--scene", default="figure-eight", help="name of the scene; an unknown name lists all (%(default)s)"
    )
    simulate.add_argument(
        "--camera",
        default=DEFAULT_CAMERA,
        type=_camera,
        metavar="CAMERA",
        help=f"one of {', '.join(CAMERA_NAMES)}, or a file of camera-profile (CAMERA.json). oak-d-pro, oak-d-sr and "
        "d435 match their depth in rendered images (%(default)s)",
    )
    _add_rendering_options(simulate)
    simulate.add_argument("--seed", type=int, default=0, metavar="N", help="random seed (%(default)s)")
    simulate.add_argument(
        "--radius", type=float, default=0.0042, metavar="M", help="radius of the strings (%(default)s)"
    )
    simulate.add_argument("--length", type=float, default=0.4, metavar="M", help="length of each string (%(default)s)")
    simulate.add_argument(
        "--softness",
        type=float,
        default=1.0,
        metavar="S",
        help="height gap at crossings, in units of 2 r, 0.6 to 1 (%(default)s)",
    )
    simulate.add_argument(
        "--crossings", type=int, metavar="N", help="number of crossings, for the scenes coil, several and random"
    )
    simulate.add_argument(
        "--strings", type=int, metavar="N", help="number of strings, for the scenes several and random"
    )
    simulate.add_argument(
        "--clearance",
        type=float,
        default=4.5,
        metavar="R",
        help="minimum distance of strands, in units of r, 2.4 to 20 (%(default)s)",
    )
    simulate.add_argument(
        "--clutter", type=int, default=0, metavar="N", help="number of boxes beside the strings (%(default)s)"
    )
    simulate.add_argument("--views", type=int, default=8, metavar="N", help="number of views (%(default)s)")
    simulate.add_argument(
        "--resolution",
        type=_resolution,
        metavar="WxH",
        help="size of the depth image, at least 32x20 (the camera's own)",
    )
    simulate.set_defaults(run=_simulate)

    serve = commands.add_parser(
        "serve",
        help="run the HTTP service and the console",
        description="Run the service until Ctrl-C or SIGTERM. A supervisor process restarts it if it dies or hangs.",
    )
    serve.add_argument("--config", type=Path, metavar="TOML", help="configuration file")
    serve.add_argument("--host", help="address to listen on (127.0.0.1)")
    serve.add_argument("--port", type=int, help="TCP port (8000)")
    serve.add_argument("--data-dir", type=Path, metavar="DIR", help="folder of recordings, results and the database")
    serve.add_argument("--unsupervised", action="store_true", help="run without the supervisor process")
    serve.add_argument("--supervised", type=int, metavar="N", help=argparse.SUPPRESS)  # set by the supervisor
    serve.set_defaults(run=_serve)
    add_token_commands(commands)
    add_audit_command(commands)
    add_doctor_command(commands)

    bench = commands.add_parser(
        "bench",
        help="measure accuracy, speed, the simulated cell and the service under load; needs a checkout of the sources",
        description="Measure speed, memory and growth of recognition on this machine, a live scan of the simulated "
        "cell, the service under load, and the accuracy of every method on simulated scenes, tier by tier; or, on "
        "request, the share of grasps that lift the right string in a simulation with contact and friction, and the "
        "accuracy of live scans with views as needed. Print Markdown tables on stdout as they are known, and progress "
        "with the remaining time on stderr. The scenes are the same every time. The wheel does not contain the "
        "benchmark: run it in a checkout of the sources.",
    )
    bench.add_argument(
        "--only",
        choices=("speed", "cell", "service", "accuracy", "grasps", "views"),
        help="measure this part only; grasps (an hour or more) and views are not measured otherwise",
    )
    bench.add_argument("--seeds", type=int, default=40, metavar="N", help="scenes of each tier (%(default)s)")
    bench.add_argument(
        "--tiers", type=_names, default=(), metavar="A,B", help="tiers to measure; an unknown name lists all (all)"
    )
    bench.add_argument("--jobs", type=int, metavar="N", help="processes of accuracy, grasps and views (one per core)")
    bench.add_argument(
        "--camera",
        default=DEFAULT_CAMERA,
        choices=CAMERA_NAMES,
        help="camera of speed, accuracy, grasps and views (%(default)s)",
    )
    add_json_option(bench, "one JSON document, with the result of each scene")
    bench.set_defaults(run=_bench)

    demo = commands.add_parser(
        "demo", help="scan a simulated string, recognise it and show the result; needs no hardware"
    )
    demo.add_argument("folder", nargs="?", type=Path, default=Path("demo"), help="folder to write (%(default)s)")
    demo.add_argument(
        "--camera", default=DEFAULT_CAMERA, choices=CAMERA_NAMES, help="camera, as of simulate (%(default)s)"
    )
    demo.set_defaults(run=_demo)

    openapi = commands.add_parser("openapi", help="print the OpenAPI description of the HTTP interface as JSON")
    openapi.set_defaults(run=_openapi)
    return parser


def _camera(text: str) -> str:
    """Return a name of a camera, or the path of a camera file. Its content is checked when it is read."""
    if text in CAMERA_NAMES or is_preset_path(text):
        return text
    raise argparse.ArgumentTypeError(
        f"there is no camera {text!r}: choose one of {', '.join(CAMERA_NAMES)}, or give a file of camera-profile, "
        "whose name ends with .json"
    )


def _add_rendering_options(simulate: argparse.ArgumentParser) -> None:
    simulate.add_argument(
        "--sheath",
        choices=("speckled", "painted", "woven", "smooth"),
        help="surface of the strings in rendered images (one with texture, drawn from the seed)",
    )
    simulate.add_argument(
        "--table-top",
        choices=("printed", "grained", "bare"),
        help="surface of the table in rendered images (one with texture, drawn from the seed)",
    )
    simulate.add_argument(
        "--ir-dots", type=float, default=0.0, metavar="SHARE", help="power of the dot projector, 0 to 1 (%(default)s)"
    )
    simulate.add_argument(
        "--no-image-cache", action="store_true", help="do not keep rendered images in the user's cache folder"
    )


def _resolution(text: str) -> tuple[int, int]:
    width, _, height = text.partition("x")
    try:
        return int(width), int(height)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not WxH, as in 640x400") from None


def _names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())


def _simulate(options: argparse.Namespace) -> int:
    from cell.config.camera_config import IMAGE_CACHE_BYTES
    from cell.config.rendering_options import RenderingOptions
    from cell.simulation.offline_scan import refuse_existing, simulate, write_simulation
    from cell.simulation.rendering.depth_camera import camera_model
    from cell.simulation.rendering.image_cache import ImageCache
    from cell.simulation.scenes.scenes import make_scene

    try:
        refuse_existing(options.out)
        camera = camera_model(options.camera, options.resolution)
        scene = make_scene(
            options.scene,
            options.seed,
            radius_m=options.radius,
            length_m=options.length,
            softness=options.softness,
            crossings=options.crossings,
            clutter=options.clutter,
            strings=options.strings,
            clearance=options.clearance,
        )
        rendering = RenderingOptions(options.sheath, options.table_top, options.ir_dots)
        cache = None if options.no_image_cache else ImageCache(IMAGE_CACHE_BYTES)
        scan = simulate(scene, camera, options.seed, views=options.views, rendering=rendering, cache=cache)
        truth = write_simulation(scan, options.out)
    except ValueError as error:
        print(f"pointchain simulate: {error}", file=sys.stderr)
        return 1
    except OSError as error:
        print(f"pointchain simulate: {options.out} cannot be written: {error.strerror}", file=sys.stderr)
        return 1
    print(f"wrote {options.out} and {truth}", file=sys.stderr)
    return 0


def _serve(options: argparse.Namespace) -> int:
    if options.supervised is None and not options.unsupervised:
        from service.logs.setup import configure_logging
        from service.server.supervisor import supervise

        configure_logging("auto", "info")
        given = {"config": options.config, "host": options.host, "port": options.port, "data-dir": options.data_dir}
        return supervise([f"--{name}={value}" for name, value in given.items() if value is not None])

    from service.config.loader import ConfigError, load_config

    try:
        config = load_config(options.config, host=options.host, port=options.port, data_dir=options.data_dir)
    except ConfigError as error:
        print(f"pointchain serve: {error}", file=sys.stderr)
        return 1
    from service.cli.commands.serve import serve

    return serve(config, options.supervised)


def _bench(options: argparse.Namespace) -> int:
    if find_spec("service.benchmark") is None:  # a wheel does not contain it
        print(
            "pointchain bench: the benchmark is not part of the installed package, because it is only for development; "
            "run `pointchain bench` in a checkout of the sources",
            file=sys.stderr,
        )
        return 2
    from service.benchmark.command import BenchOptions, bench

    chosen = BenchOptions(options.only, options.tiers, options.seeds, options.jobs, options.camera)
    return bench(chosen, options.json)


def _demo(options: argparse.Namespace) -> int:
    from service.cli.commands.demo import demo

    return demo(options.folder, options.camera)


def _openapi(options: argparse.Namespace) -> int:
    from service.app import openapi_document

    sys.stdout.write(openapi_document())
    return 0
