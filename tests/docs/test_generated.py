"""The generated pages match the code."""

import subprocess
import sys

from tests.docs.pages import GENERATED, ROOT


def test_generated_pages_are_up_to_date() -> None:
    done = subprocess.run(
        [sys.executable, "docs/generate.py", "--check"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


def test_all_generated_pages_are_checked() -> None:
    sys.path.insert(0, str(ROOT / "docs"))
    try:
        import generate
    finally:
        sys.path.pop(0)
    assert {f"docs/{name}" for name in generate.PAGES} == GENERATED
