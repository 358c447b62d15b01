"""Small scans for bags, and helpers that import and compare them."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from calibration.geometry.transforms import from_rotation_vector
from cell.bag.import_bag import BagRequest, ImportedBag, import_bag
from cell.devices import View
from cell.recording import Recording, read_recording
from tests.cell.bag.bags import START_NS, Kind, Moment, write_bag

T_FLANGE_CAMERA = from_rotation_vector((0.03, -0.06, 0.05), (0.1, 0.05, 0.4))


FINE = BagRequest(depth_unit_m=1e-4)


def made_views(count: int) -> list[View]:
    """Return views of noise, each from another side, three seconds apart."""
    rng = np.random.default_rng(7)
    return [
        View(
            index=k,
            depth=rng.integers(1000, 9000, (12, 16), dtype=np.uint16) * (rng.random((12, 16)) > 0.2).astype(np.uint16),
            depth_unit_m=1e-4,
            K=np.array([[20.0, 0, 7.5], [0, 21.0, 5.5], [0, 0, 1]]),
            T_base_flange=from_rotation_vector((0.3, 0.05 * k, 0.4), (0.1 * k, 3.0, 0.1)),
            T_flange_camera=T_FLANGE_CAMERA,
            stamp_s=START_NS / 1e9 + 3 * k,
        )
        for k in range(count)
    ]


def imported(
    folder: Path, moments: Iterable[Moment], request: BagRequest = FINE, kind: Kind = "mcap"
) -> tuple[ImportedBag, Recording]:
    bag = write_bag(folder / ("scan.bag" if kind == "ros1" else "scan"), kind, moments)
    out = folder / "scan.mcap"
    contents = import_bag(bag, out, request)
    assert {path.name for path in folder.iterdir()} == {bag.name, out.name}, "no other file is left"
    return contents, read_recording(out)


def assert_same_views(got: Recording, request: list[View]) -> None:
    assert len(got.views) == len(request)
    for a, b in zip(got.views, request, strict=True):
        np.testing.assert_array_equal(a.depth, b.depth)
        np.testing.assert_array_equal(a.K, b.K)
        # Quaternions and a chain of frames cause rounding errors of doubles.
        np.testing.assert_allclose(a.T_base_flange, b.T_base_flange, rtol=0, atol=1e-12)
        np.testing.assert_allclose(a.T_flange_camera, b.T_flange_camera, rtol=0, atol=1e-12)
