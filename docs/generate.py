"""Write the pages that are generated from code. `--check` names those that are out of date instead."""

import sys
from pathlib import Path

from generated import command_line, configuration, errors, findings, parameters

DOCS = Path(__file__).resolve().parent
PAGES = {
    "integrator/configuration.md": configuration.page(),
    "researcher/parameters.md": parameters.page(),
    **errors.pages(),
    **findings.pages(),
    **command_line.pages(),
}
"""Text of each page, by its path."""


def main() -> int:
    """Write the pages, or check them; return 1 when one is out of date."""
    stale = []
    for name, text in PAGES.items():
        path = DOCS / name
        if not path.is_file() or path.read_text() != text:
            stale.append(name)
            if "--check" not in sys.argv:
                path.parent.mkdir(exist_ok=True)
                path.write_text(text)
    if "--check" in sys.argv and stale:
        print(f"out of date: {', '.join(stale)}; run docs/generate.py", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
