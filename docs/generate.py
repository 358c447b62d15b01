"""Write the pages that are generated from code. `--check` names those that are out of date instead."""

import sys
from pathlib import Path

from generated import command_line, configuration, errors, findings, parameters

DOCS = Path(__file__).resolve().parent
PAGES = {
    "planner/errors.md": errors.page,
    "planner/findings.md": findings.page,
    "integrator/configuration.md": configuration.page,
    "researcher/parameters.md": parameters.page,
    "reference/command-line.md": command_line.page,
}


def main() -> int:
    """Write the pages, or check them; return 1 when one is out of date."""
    stale = []
    for name, page in PAGES.items():
        path, text = DOCS / name, page()
        if not path.is_file() or path.read_text() != text:
            stale.append(name)
            if "--check" not in sys.argv:
                path.write_text(text)
    if "--check" in sys.argv and stale:
        print(f"out of date: {', '.join(stale)}; run docs/generate.py", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
