"""The tools of the page of a result: files."""

import csv
import io
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from playwright.sync_api import Locator, Page

from service.interchange.point_files import to_csv
from tests.service.conftest import ServedClient
from tests.service.console.conftest import Open, original_model, wait_until_drawn

pytestmark = pytest.mark.xdist_group("console")  # one at a time: each test runs several busy processes


def download(page: Page, button: Locator) -> tuple[str, bytes]:
    """Press a button or a link, and return the name and the content of the file that it saves."""
    with page.expect_download() as downloaded:
        button.click()
    return downloaded.value.suggested_filename, Path(downloaded.value.path()).read_bytes()


def test_all_files_of_a_result_are_saved(open_console: Open, crossed: ServedClient) -> None:
    scan = crossed.get("/api/scans").json()["scans"][-1]
    page = open_console(crossed, f"#/result/{scan['id']}").page
    wait_until_drawn(page)
    files = page.get_by_role("region", name="Files")
    for name, link, ending in (
        ("Model (JSON)", "model", ".json"),
        ("Grasps (JSON)", "grasps", "-grasps.json"),
        ("Points (PLY)", "cloud", ".ply"),
        ("Recording (MCAP)", "recording", ".mcap"),
    ):
        content = crossed.get(scan["links"][link]).content
        assert download(page, files.get_by_role("link", name=name)) == (f"{scan['id']}{ending}", content)

    name, table = download(page, files.get_by_role("button", name="Centre lines (CSV)"))
    assert name == f"{scan['id']}-centre-lines.csv"
    expected = to_csv(original_model(crossed))
    assert rows(table)[0] == rows(expected)[0]
    np.testing.assert_array_equal(numbers(table), numbers(expected))

    save_picture = files.get_by_role("button", name="Picture as shown (PNG)")
    name, with_labels = download(page, save_picture)
    assert name == f"{scan['id']}.png"
    page.locator("canvas").scroll_into_view_if_needed()
    shown = page.locator("canvas").screenshot()
    page.get_by_label("Labels", exact=True).uncheck()
    _, without_labels = download(page, save_picture)
    assert difference(with_labels, shown) < 0.3 * difference(without_labels, shown)


def difference(saved: bytes, shown: bytes) -> float:
    """Return the share of a picture that differs, in steps of 8 pixels: texts may be a pixel apart."""
    size = (80, 40)
    images = [Image.open(io.BytesIO(one)).convert("L").resize(size, Image.Resampling.BOX) for one in (saved, shown)]
    first, second = (np.asarray(one, dtype=np.int16) for one in images)
    return float(np.mean(np.abs(first - second) > 20))


def rows(table: bytes) -> list[list[str]]:
    """Return the rows of a CSV file."""
    return list(csv.reader(io.StringIO(table.decode(), newline="")))


def numbers(table: bytes) -> NDArray[np.float64]:
    """Return the numbers of a CSV file without its header."""
    return np.array(rows(table)[1:], dtype=np.float64)
