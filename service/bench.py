"""`pointchain bench`: accuracy of every method on simulated scenes, as a table."""

import json
import sys
from dataclasses import asdict

from cell.simulation.benchmark import TIER, paper_like, run, summarise, table


def bench(seeds: int, jobs: int | None, as_json: bool) -> int:
    """Runs `seeds` paper-like scenes; prints a Markdown table, or JSON with every case."""
    from tqdm import tqdm

    if seeds < 1 or (jobs is not None and jobs < 1):
        print("pointchain bench: --seeds and --jobs must be at least 1", file=sys.stderr)
        return 1
    with tqdm(total=seeds, unit="scene", disable=not sys.stderr.isatty()) as bar:
        results = list(run(paper_like(seeds), jobs, bar.update))
    summaries = summarise(results)
    if as_json:
        accuracy = {TIER: {method: asdict(summary) for method, summary in summaries.items()}}
        print(json.dumps({"accuracy": accuracy, "cases": [asdict(result) for result in results]}))
    else:
        print(table(summaries))
    return 0
