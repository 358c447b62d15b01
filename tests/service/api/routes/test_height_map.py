"""Routes of the height map of a scan: values and image."""

import time
from collections.abc import Callable
from typing import Any

import cv2
import httpx2
import numpy as np
import pytest

from service.api.response_cache import MAX_AGE_S
from service.api.schemas.scans import HeightMapDocument
from service.storage.data_folder import HEIGHT_MAP
from tests.service.conftest import ServedClient

AssertProblem = Callable[[httpx2.Response, int, str], str]


@pytest.fixture(scope="module")
def heights(client: ServedClient, scan: dict[str, Any]) -> dict[str, Any]:
    answer = client.get(scan["links"]["height_map"])
    assert answer.status_code == 200, answer.text
    HeightMapDocument.model_validate_json(answer.content)
    return answer.json()


def values(heights: dict[str, Any]) -> np.ndarray:
    """Return the heights (M, N), NaN where unmeasured."""
    return np.array(heights["z_m"], dtype=np.float64)


def test_the_values_are_heights_of_string_and_table(
    client: ServedClient, scan: dict[str, Any], heights: dict[str, Any]
) -> None:
    z_m = values(heights)
    (chain,) = client.get(scan["links"]["model"]).json()["chains"]
    points = np.array(chain["points"])
    i, j = ((points[:, :2] - (heights["x_m"], heights["y_m"])) / heights["cell_m"]).astype(int).T
    # Without noise, the mean of a cell that the string crosses is lower than its top by what a cell of 2 mm rounds off.
    on_string = z_m[i, j] - points[:, 2]
    assert np.nanmedian(on_string) == pytest.approx(chain["radius_m"], abs=0.0015)
    assert np.nanmedian(z_m) == pytest.approx(heights["table_z_m"], abs=1e-4)
    assert np.isfinite(z_m).mean() > 0.5
    assert heights["min_object_height_m"] == pytest.approx(0.0012)


def test_the_image_has_a_pixel_for_each_cell(
    client: ServedClient, scan: dict[str, Any], heights: dict[str, Any]
) -> None:
    answer = client.get(scan["links"]["height_map"] + ".png")
    assert (answer.status_code, answer.headers["content-type"]) == (200, "image/png")
    image = cv2.imdecode(np.frombuffer(answer.content, np.uint8), cv2.IMREAD_UNCHANGED)
    assert image is not None
    z_m = values(heights)
    measured = np.isfinite(z_m)
    # x to the right, y up
    np.testing.assert_array_equal(image[::-1, :, 3].T == 255, measured)
    yellow = image[::-1, :, 2].T.astype(float)
    assert yellow[measured & (z_m > 0.006)].min() > yellow[measured & (np.abs(z_m) < 0.001)].max()
    again = client.get(scan["links"]["height_map"] + ".png", headers={"If-None-Match": answer.headers["ETag"]})
    assert again.status_code == 304


@pytest.mark.parametrize("ending", ["", ".png"])
def test_a_damaged_file_is_reported(
    client: ServedClient, scan: dict[str, Any], assert_problem: AssertProblem, ending: str
) -> None:
    path = client.app.state.context.store.folder.results(scan["id"]) / HEIGHT_MAP
    whole = path.read_bytes()
    address = scan["links"]["height_map"] + ending
    try:
        for harm in (lambda: path.write_bytes(whole[:-1]), path.unlink):
            harm()
            time.sleep(MAX_AGE_S)  # until the cached answer expires
            assert "pointchain doctor" in assert_problem(client.get(address), 500, "damaged")
    finally:
        path.write_bytes(whole)
    assert client.get(address).status_code == 200
