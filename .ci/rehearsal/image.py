"""Carries out a Dockerfile without Docker: each stage's steps in order, in a root of its own.

Only what our Dockerfile uses is understood; anything else is refused, so that no step is left out silently.
"""

import os
import re
import shlex
import shutil
import subprocess
import time
from dataclasses import dataclass, field
from pathlib import Path

import bare_root
import dockerfile

FROM = "debian:bookworm-slim"
"""What debootstrap's minbase stands for."""


@dataclass
class Image:
    """What a stage comes to."""

    root: Path
    variables: dict[str, str] = field(default_factory=lambda: {"PATH": bare_root.PATH})
    arguments: dict[str, str] = field(default_factory=dict)
    folder: str = "/"
    user: str = "0:0"
    volumes: list[str] = field(default_factory=list)
    stop_signal: str = "SIGTERM"
    health: tuple[str, ...] = ()
    entry: tuple[str, ...] = ()
    command: tuple[str, ...] = ()


def build(file: Path, context: Path, bare: Path, work: Path) -> Image:
    """Carries out `file`; the last stage. `context` has what the build may copy."""
    stages: list[Image] = []
    names: dict[str, Image] = {}
    for step in dockerfile.parse_file(str(file)):
        value, stage = list(step.value), stages[-1] if stages else None
        print(f"    {step.original}", flush=True)
        began_s = time.monotonic()
        if step.cmd.upper() == "FROM":
            if value[0] != FROM:
                raise SystemExit(f"FROM {value[0]}: only {FROM} can be stood in for")
            stages.append(Image(work / f"stage{len(stages)}"))
            bare_root.copy(bare, stages[-1].root)
            if len(value) == 3:
                names[value[2]] = stages[-1]
        elif stage is None:
            raise SystemExit(f"{step.original}: before the first FROM nothing is understood")
        else:
            _step(step, value, stage, names, context)
        if time.monotonic() - began_s > 1:
            print(f"    ... {time.monotonic() - began_s:.0f} s", flush=True)
    return stages[-1]


def _step(  # noqa: PLR0912  one case for each instruction
    step: dockerfile.Command, value: list[str], stage: Image, names: dict[str, Image], context: Path
) -> None:
    known = {**stage.arguments, **stage.variables}
    match step.cmd.upper():
        case "ARG":
            name, _, default = value[0].partition("=")
            stage.arguments[name] = default
        case "ENV":
            # All of one step see the variables as they were before it.
            stage.variables |= {name: _filled(text, known) for name, text in zip(value[::2], value[1::2], strict=True)}
        case "WORKDIR":
            stage.folder = str(Path(stage.folder, _filled(value[0], known)))
            (stage.root / stage.folder.lstrip("/")).mkdir(parents=True, exist_ok=True)
        case "COPY":
            origin = context
            for flag in step.flags:
                if not flag.startswith("--from="):
                    raise SystemExit(f"{step.original}: {flag} is not understood")
                origin = names[flag.removeprefix("--from=")].root
            _copy(origin, value[:-1], stage, value[-1])
        case "RUN" if not step.flags and stage.user == "0:0":
            command = value if step.json else ["/bin/sh", "-c", value[0]]
            # HOME as Docker has it for root; the machine's variables are lent, and part of no image.
            variables = {"HOME": "/root", **bare_root.lent_variables(), **known}
            bare_root.run(stage.root, command, variables, stage.folder)
        case "USER" if re.fullmatch(r"\d+:\d+", value[0]):
            stage.user = value[0]
        case "VOLUME":
            stage.volumes += value
        case "STOPSIGNAL":
            stage.stop_signal = value[0]
        case "HEALTHCHECK" if step.json and value[0] == "CMD":
            stage.health = tuple(value[1:])
        case "ENTRYPOINT" if step.json:
            stage.entry = tuple(value)
        case "CMD" if step.json:
            stage.command = tuple(value)
        case "EXPOSE":
            pass
        case _:
            raise SystemExit(f"{step.original}: not understood")


def _filled(text: str, variables: dict[str, str]) -> str:
    return re.sub(r"\$(?:(\w+)|\{(\w+)\})", lambda name: variables.get(name[1] or name[2], ""), text)


def _copy(origin: Path, sources: list[str], stage: Image, target: str) -> None:
    """A folder's content, or files, owned by root with their modes."""
    to = stage.root / str(Path(stage.folder, target)).lstrip("/")
    for source in sources:
        there = origin / source.lstrip("/")
        if not there.exists():
            raise SystemExit(f"COPY {source}: it is not there, or .dockerignore leaves it out")
        (to if there.is_dir() or target.endswith("/") else to.parent).mkdir(parents=True, exist_ok=True)
        copied = f"{there}/." if there.is_dir() else there
        subprocess.run(["cp", "--archive", "--no-preserve=ownership", copied, to], check=True)


def context(project: Path, ignore: Path, target: Path) -> None:
    """Copies of the project what Docker would send to the build."""
    patterns = [line for line in ignore.read_text().splitlines() if line and not line.startswith("#")]
    for folder, folders, files in os.walk(project):
        here = Path(folder).relative_to(project)
        folders[:] = [
            name for name in folders if not _left_out(here / name, patterns) or _comes_back(here / name, patterns)
        ]
        for name in files:
            if not _left_out(here / name, patterns):
                (target / here).mkdir(parents=True, exist_ok=True)
                shutil.copy2(Path(folder, name), target / here / name)


def _left_out(path: Path, patterns: list[str]) -> bool:
    """The last pattern that fits the path, or a folder above it, decides."""
    out = False
    for pattern in patterns:
        if any(_fits(way, pattern.removeprefix("!")) for way in (path, *path.parents[:-1])):
            out = not pattern.startswith("!")
    return out


def _fits(path: Path, pattern: str) -> bool:
    return path.match(pattern.removeprefix("**/")) if pattern.startswith("**/") else ("/" / path).match(f"/{pattern}")


def _comes_back(path: Path, patterns: list[str]) -> bool:
    return any(pattern.startswith(f"!{path}/") for pattern in patterns)


def shown(image: Image) -> str:
    """What would be started."""
    return f"{shlex.join([*image.entry, *image.command])}, as {image.user}"
