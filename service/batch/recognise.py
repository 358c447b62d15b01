"""`pointchain recognise`: recordings in, one JSON document a line out."""

import os
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

from service.batch.cluster import local_cluster, on_cluster
from service.batch.errors import ArchiveError
from service.batch.formats import PARQUET, require_parquet
from service.batch.output_file import output
from service.batch.recognise_file import Asked, Line, recognise_file


@dataclass(frozen=True)
class Where:
    """Where the work is done, and where its lines go."""

    out: Path | None = None
    """The file for them; None: stdout."""
    jobs: int | None = None
    """How many processes of this machine."""
    cluster: str | None = None
    """Address of a Dask scheduler. Neither: this process, one after the other."""
    trace: Path | None = None
    """Folder for pictures of every stage; in this process only."""


def recognise(files: Sequence[Path], asked: Asked, where: Where) -> int:
    """Recognises each recording; its model, or `{"schema", "error"}`, is a line of its own, in the order given.

    A folder stands for the recordings in it. A progress bar goes to stderr when that is a terminal. Returns 1 when a
    file failed, or the run cannot go on, which is told; else 0.
    """
    try:
        names = [str(name) for file in files for name in _recordings(file)]
        once = list(dict.fromkeys(names))
        if where.trace is not None:
            _require_names_of_their_own(once)
        if where.out is not None:
            return _kept(once, asked, where, where.out)
        failed = 0
        for line in _in_order(names, _lines(once, asked, where)):
            print(line.text, flush=True)
            failed += line.reason is not None
    except ArchiveError as error:
        print(f"pointchain recognise: {error}", file=sys.stderr)
        return 1
    return 1 if failed else 0


def _recordings(file: Path) -> list[Path]:
    if not file.is_dir():
        return [file]
    found, been = [], set()
    for folder, folders, names in os.walk(file, followlinks=True, onerror=_tell_unreadable):
        there = Path(folder).resolve()
        if there in been:  # by a link, maybe to a folder above it
            folders.clear()
            continue
        been.add(there)
        found += [Path(folder, name) for name in names if name.endswith(".mcap")]
    if not found:
        raise ArchiveError(f"the folder {file} has no recordings (*.mcap)")
    return sorted(found)


def _tell_unreadable(error: OSError) -> NoReturn:
    raise ArchiveError(f"the folder {error.filename} cannot be read: {error.strerror or error}") from error


def _require_names_of_their_own(names: Sequence[str]) -> None:
    """Raises ArchiveError: the pictures of two recordings would be in one folder."""
    count = Counter(Path(name).stem for name in names)
    twice = sorted(stem for stem in count if count[stem] > 1)
    if twice:
        raise ArchiveError(
            f"{count[twice[0]]} recordings are called {twice[0]}, and their pictures would be in one folder: give them "
            "one by one, each with a --trace of its own"
        )


def _kept(names: Sequence[str], asked: Asked, where: Where, out: Path) -> int:
    """The same into a file, which an earlier run may have begun."""
    if out.suffix == PARQUET:
        require_parquet()
    with output(out, asked) as lines:
        left = lines.left(names)
        for line in _lines(left, asked, where):
            lines.add(line)
        lines.finish(names)
        failed, others = lines.failures(names), lines.others(names)
    print(
        f"{out}: {len(names) - failed} of {len(names)} recordings have a model, "
        f"{len(names) - len(left)} had their line already"
        + (f"; {others} more lines, of recordings not asked for now, stay" if others else ""),
        file=sys.stderr,
    )
    return 1 if failed else 0


def _lines(names: Sequence[str], asked: Asked, where: Where) -> Iterator[Line]:
    """The lines as they come, with what a person is told of them."""
    from tqdm import tqdm

    if not names:
        return
    with ExitStack() as stack:
        bar = stack.enter_context(tqdm(total=len(names), unit="recording", disable=not sys.stderr.isatty()))
        if where.cluster is not None:
            coming = on_cluster(names, asked, where.cluster)
        elif where.jobs is not None:
            coming = on_cluster(names, asked, stack.enter_context(local_cluster(where.jobs)))
        else:
            coming = (recognise_file(name, asked, where.trace, bar.set_postfix_str) for name in names)
        for line in coming:
            bar.update()
            for message in line.notes if line.reason is None else (line.reason,):
                bar.write(f"pointchain recognise: {line.file}: {message}", file=sys.stderr)
            yield line


def _in_order(names: Sequence[str], lines: Iterator[Line]) -> Iterator[Line]:
    """The lines in the order of `names`, which may have one twice; each as soon as those before it are there."""
    early: dict[str, Line] = {}
    to_come = Counter(names)
    wanted = iter(names)
    name = next(wanted, None)
    for line in lines:
        early[line.file] = line
        while name in early:
            yield early[name]
            to_come[name] -= 1
            if not to_come[name]:
                del early[name]
            name = next(wanted, None)
