"""`pointchain recognise`: recordings in, one JSON document per line out."""

import os
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

from recognition.request import RecognitionRequest
from service.batch.cluster import local_cluster, recognise_on_cluster
from service.batch.errors import BatchError
from service.batch.formats import PARQUET, require_parquet
from service.batch.output_file import open_output
from service.batch.recognise_file import RecordingLine, recognise_file


@dataclass(frozen=True)
class RunOptions:
    """Where a run does its work, and where it writes.

    With neither `jobs` nor `cluster`, this process recognises the recordings one after the other.
    """

    out: Path | None = None
    """Output file. None: stdout."""
    jobs: int | None = None
    """Number of local processes."""
    cluster: str | None = None
    """Address of a Dask scheduler."""
    trace: Path | None = None
    """Folder for pictures of every stage. Only a run in this process writes them."""


def recognise(files: Sequence[Path], request: RecognitionRequest, options: RunOptions) -> int:
    """Recognise recordings and write one line for each, in the given order.

    A line holds the model, or `{"schema", "error"}`. A progress bar goes to stderr if that is a terminal.

    Args:
        files: Recordings. A folder stands for all recordings in it.
        request: How to recognise them.
        options: Where to work and write.

    Returns:
        Exit code: 0 if every recording has a model; 1 if one failed, or if the run stopped with a message on stderr.
    """
    try:
        names = [str(name) for file in files for name in _recordings(file)]
        unique = list(dict.fromkeys(names))
        if options.trace is not None:
            _require_unique_stems(unique)
        if options.out is not None:
            return _write_output(unique, request, options, options.out)
        failed = 0
        for line in _in_order(names, _recognise_all(unique, request, options)):
            print(line.text, flush=True)
            failed += line.reason is not None
    except BatchError as error:
        print(f"pointchain recognise: {error}", file=sys.stderr)
        return 1
    return 1 if failed else 0


def _recordings(file: Path) -> list[Path]:
    if not file.is_dir():
        return [file]
    found, visited = [], set()
    for folder, folders, names in os.walk(file, followlinks=True, onerror=_raise_unreadable):
        resolved = Path(folder).resolve()
        if resolved in visited:  # reached by a link, perhaps to a parent folder
            folders.clear()
            continue
        visited.add(resolved)
        found += [Path(folder, name) for name in names if name.endswith(".mcap")]
    if not found:
        raise BatchError(f"the folder {file} has no recordings (*.mcap)")
    return sorted(found)


def _raise_unreadable(error: OSError) -> NoReturn:
    raise BatchError(f"the folder {error.filename} cannot be read: {error.strerror or error}") from error


def _require_unique_stems(names: Sequence[str]) -> None:
    """Raise BatchError if the pictures of two recordings would share a folder."""
    count = Counter(Path(name).stem for name in names)
    repeated = sorted(stem for stem in count if count[stem] > 1)
    if repeated:
        raise BatchError(
            f"{count[repeated[0]]} recordings are called {repeated[0]}, and their pictures would share one folder: "
            "run the command once for each, with different folders for --trace"
        )


def _write_output(names: Sequence[str], request: RecognitionRequest, options: RunOptions, out: Path) -> int:
    """Write the lines to a file, which an earlier run may have begun, and return the exit code."""
    if out.suffix == PARQUET:
        require_parquet()
    with open_output(out, request) as output:
        remaining = output.remaining(names)
        for line in _recognise_all(remaining, request, options):
            output.add(line)
        output.finish(names)
        failed, others = output.count_failures(names), output.count_others(names)
    print(
        f"{out}: {len(names) - failed} of {len(names)} recordings have a model, "
        f"{len(names) - len(remaining)} were done before"
        + (f"; {others} lines of other recordings were kept" if others else ""),
        file=sys.stderr,
    )
    return 1 if failed else 0


def _recognise_all(names: Sequence[str], request: RecognitionRequest, options: RunOptions) -> Iterator[RecordingLine]:
    """Yield each line as soon as it is done, and print its messages to stderr."""
    from tqdm import tqdm

    if not names:
        return
    with ExitStack() as stack:
        bar = stack.enter_context(tqdm(total=len(names), unit="recording", disable=not sys.stderr.isatty()))
        if options.cluster is not None:
            lines = recognise_on_cluster(names, request, options.cluster)
        elif options.jobs is not None:
            lines = recognise_on_cluster(names, request, stack.enter_context(local_cluster(options.jobs)))
        else:
            lines = (recognise_file(name, request, options.trace, bar.set_postfix_str) for name in names)
        for line in lines:
            bar.update()
            for message in line.notes if line.reason is None else (line.reason,):
                bar.write(f"pointchain recognise: {line.file}: {message}", file=sys.stderr)
            yield line


def _in_order(names: Sequence[str], lines: Iterator[RecordingLine]) -> Iterator[RecordingLine]:
    """Yield the lines in the order of `names`, each as soon as all before it are done. A name may occur twice."""
    waiting: dict[str, RecordingLine] = {}
    uses_left = Counter(names)
    ordered = iter(names)
    name = next(ordered, None)
    for line in lines:
        waiting[line.file] = line
        while name in waiting:
            yield waiting[name]
            uses_left[name] -= 1
            if not uses_left[name]:
                del waiting[name]
            name = next(ordered, None)
