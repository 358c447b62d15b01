"""`pointchain recognise`: recordings in, one JSON document a line out."""

import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from service.archive.cluster import local_cluster, on_cluster
from service.archive.errors import ArchiveError
from service.archive.formats import PARQUET, require_parquet
from service.archive.one_file import Asked, Line, recognise_file
from service.archive.output import output


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
    found = sorted(file.rglob("*.mcap"))
    if not found:
        raise ArchiveError(f"the folder {file} has no recordings (*.mcap)")
    return found


def _kept(names: Sequence[str], asked: Asked, where: Where, out: Path) -> int:
    """The same into a file, which an earlier run may have begun."""
    if out.suffix == PARQUET:
        require_parquet()
    with output(out, asked) as lines:
        left = lines.left(names)
        for line in _lines(left, asked, where):
            lines.add(line)
        lines.finish(names)
        failed = lines.failures(names)
    print(
        f"{out}: {len(names) - failed} of {len(names)} recordings have a model, "
        f"{len(names) - len(left)} had their line already",
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
            if line.reason is not None:
                bar.write(f"pointchain recognise: {line.file}: {line.reason}", file=sys.stderr)
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
