"""The example that imports a user's own depth images runs without changes."""

import os
import subprocess
import sys
from pathlib import Path

EXAMPLE = Path(__file__).parents[2] / "examples" / "import_own_frames.py"


def test_the_example_imports_a_folder_and_finds_the_string(tmp_path: Path) -> None:
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = os.environ | {"PATH": path, "TMPDIR": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, str(EXAMPLE)], capture_output=True, text=True, env=environment, timeout=180, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.endswith("own.mcap: 1 strings, 1 crossings\n")
    assert "depth unit: 0.0001 m (camera.json)" in done.stderr
