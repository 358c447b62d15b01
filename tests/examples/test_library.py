"""The example programs that use recognition as a library."""

import json
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest
from matplotlib.image import imread

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


def run(name: str, *arguments: Path) -> subprocess.CompletedProcess[str]:
    """Run an example program with warnings as errors."""
    return subprocess.run(
        [sys.executable, "-W", "error", str(EXAMPLES / name), *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
        timeout=200,
    )


@pytest.fixture(scope="module")
def model_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The model file that the first example writes."""
    path = tmp_path_factory.mktemp("library") / "knot.json"
    done = run("recognise_as_library.py", path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("crossing ") == 3
    length = re.search(r"^chain 0: (\d+) mm", done.stdout)
    assert length is not None
    # The string is 400 mm long, and both ends are found to a millimetre.
    assert int(length[1]) == pytest.approx(400, abs=2)
    return path


def test_the_library_example_saves_its_model(model_file: Path) -> None:
    model = json.loads(model_file.read_text())
    assert model["schema"] == "pointchain/2"
    assert len(model["chains"]) == 1


def test_a_model_is_drawn(model_file: Path, tmp_path: Path) -> None:
    picture = tmp_path / "knot.png"
    done = run("plot_model.py", model_file, picture)
    assert done.returncode == 0, done.stderr
    pixels = imread(picture)[..., :3]
    coloured = pixels.max(axis=2) - pixels.min(axis=2) > 0.3
    # The strand and the colour bar are coloured.
    assert 0.005 < coloured.mean() < 0.2


def test_a_closed_chain_and_doubts_are_drawn(model_file: Path, tmp_path: Path) -> None:
    model = json.loads(model_file.read_text())
    model["chains"][0] |= {
        "closed": True,
        "ends": ["unobserved", "free"],
        "views": [0] * len(model["chains"][0]["views"]),
    }
    model["crossings"][0]["confidence"] = 0.6
    doubt = {"code": "crossing-undecided", "severity": "doubt", "message": "crossing 0 is not certain"}
    model["quality"] |= {"verdict": "review", "findings": [doubt]}
    changed, picture = tmp_path / "changed.json", tmp_path / "changed.svg"
    changed.write_text(json.dumps(model))
    done = run("plot_model.py", changed, picture)
    assert done.returncode == 0, done.stderr
    # Characters are drawn as outlines, and the text is in a comment beside them.
    assert "confidence 0.60" in picture.read_text()
    assert "verdict: review: crossing-undecided" in picture.read_text()


def test_an_error_document_gives_no_picture(tmp_path: Path) -> None:
    document, picture = tmp_path / "error.json", tmp_path / "error.png"
    document.write_text(json.dumps({"schema": "pointchain/2", "error": {"detail": "no view is complete"}}))
    done = run("plot_model.py", document, picture)
    assert done.returncode == 1
    assert "no view is complete" in done.stderr
    assert not picture.exists()


def test_a_model_without_strings_is_drawn(model_file: Path, tmp_path: Path) -> None:
    model = json.loads(model_file.read_text()) | {"chains": [], "crossings": []}
    empty, picture = tmp_path / "empty.json", tmp_path / "empty.png"
    empty.write_text(json.dumps(model))
    assert run("plot_model.py", empty, picture).returncode == 0
    assert picture.exists()


def test_the_accuracy_of_point_clouds_is_measured() -> None:
    """Point clouds of each viewpoint give the right model, in one scene of the table's first row."""
    example = runpy.run_path(str(EXAMPLES / "point_cloud_accuracy.py"))
    cells = [cell.strip() for cell in example["row"](example["FORMS"][0], 1).strip("|").split("|")]
    assert cells[1:4] == ["1", "1", "0"]
    own_mm, cloud_mm = (float(cell.removesuffix(" mm")) for cell in cells[4:])
    # The limits are about twice the figures in docs/researcher/own-data.md.
    assert own_mm < 0.3
    assert cloud_mm < 0.5
