"""`pointchain import cloud` makes a recording of point clouds and viewpoints that gives the right strings."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import open3d as o3d
import pytest
from numpy.typing import NDArray

from cell.recording import Recording, read_recording
from cell.simulation.evaluation.metrics import score
from cell.simulation.offline_scan import SimulatedScan, simulate
from cell.simulation.pose_errors import NO_ERRORS
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.scenes import make_scene
from recognition.preprocessing.target_cloud import deproject
from service.cli.main import main
from service.processing.results import recognise_recording

Points = NDArray[np.float64]


@pytest.fixture(scope="module")
def scan() -> SimulatedScan:
    """Return a scan of a crossing from eight sides without noise."""
    return simulate(make_scene("loop", 2), camera_model("exact", (320, 200)), 2, NO_ERRORS)


@pytest.fixture(scope="module")
def clouds(scan: SimulatedScan) -> list[Points]:
    """Return the points (N, 3) of each view, base frame."""
    return [deproject(view, *np.nonzero(view.depth)) for view in scan.views]


def write_ply(path: Path, points: Points, text: bool = False, **properties: NDArray[Any]) -> str:
    """Write points, and other properties of each, as ASCII or as binary PLY."""
    cloud = o3d.t.geometry.PointCloud(o3d.core.Tensor.from_numpy(points.astype(np.float64)))
    for name, values in properties.items():
        cloud.point[name] = o3d.core.Tensor.from_numpy(values.reshape(len(points), -1))
    assert o3d.t.io.write_point_cloud(path, cloud, write_ascii=text)
    return str(path)


def viewpoints(scan: SimulatedScan) -> list[str]:
    return [text for view in scan.views for text in ("--viewpoint", *(f"{x:.6f}" for x in view.T_base_camera[:3, 3]))]


def options(scan: SimulatedScan) -> list[str]:
    assert scan.header.workspace_m is not None
    box = [str(value) for side in scan.header.workspace_m for value in side]
    return [*viewpoints(scan), "--radius=0.0042", "--workspace", *box]


def checked_distance_m(out: Path, scan: SimulatedScan) -> float:
    """Check the strings and their crossings, and return the mean distance from the true line."""
    result = score(replace(recognise_recording(out).model, timing_s={}).to_json(), scan.truth)
    assert result.topology
    assert result.mean_m is not None
    return result.mean_m


@pytest.mark.parametrize("text", [False, True])
def test_one_file_per_viewpoint_gives_the_strings(
    scan: SimulatedScan, clouds: list[Points], tmp_path: Path, text: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    files, out = [write_ply(tmp_path / f"{k}.ply", c, text) for k, c in enumerate(clouds)], tmp_path / "out.mcap"
    assert main(["import", "cloud", *files, str(out), *options(scan)]) == 0
    err = capsys.readouterr().err
    assert "8 virtual views, by a file for each viewpoint" in err
    assert "rounding: pixels are up to" in err
    assert checked_distance_m(out, scan) < 1e-4
    recording = read_recording(out)
    assert recording.header.provenance["source"] == "point clouds"
    for view, wanted in zip(recording.views, scan.views, strict=True):
        np.testing.assert_allclose(view.T_base_camera[:3, 3], wanted.T_base_camera[:3, 3], atol=1e-6)


def test_one_viewpoint_gives_a_model_of_one_view(scan: SimulatedScan, clouds: list[Points], tmp_path: Path) -> None:
    file, out = write_ply(tmp_path / "0.ply", clouds[0]), tmp_path / "out.mcap"
    one = replace(scan, views=scan.views[:1])
    assert main(["import", "cloud", file, str(out), *options(one)]) == 0
    model = recognise_recording(out).model
    assert len(model.quality.views) == 1
    (chain,) = model.chains
    assert chain.views.max() == 1
    assert "single-view" in {found.code for found in model.quality.findings}


def test_a_merged_file_with_viewpoint_numbers_gives_the_same_views(
    scan: SimulatedScan, clouds: list[Points], tmp_path: Path
) -> None:
    separate, merged, named = (tmp_path / f"{name}.mcap" for name in ("separate", "merged", "named"))
    files = [write_ply(tmp_path / f"{k}.ply", c) for k, c in enumerate(clouds)]
    assert main(["import", "cloud", *files, str(separate), *options(scan)]) == 0
    number = np.concatenate([np.full(len(c), k, dtype=np.int32) for k, c in enumerate(clouds)])
    file = write_ply(tmp_path / "all.ply", np.vstack(clouds), view=number)
    assert main(["import", "cloud", file, str(merged), *options(scan)]) == 0
    file = write_ply(tmp_path / "scans.ply", np.vstack(clouds), scan=number.astype(np.uint8))
    assert main(["import", "cloud", file, str(named), *options(scan), "--view-property=scan"]) == 0
    for other in (merged, named):
        assert depths(read_recording(other)) == depths(read_recording(separate))


def depths(recording: Recording) -> list[bytes]:
    return [view.depth.tobytes() for view in recording.views]


def test_a_merged_file_without_viewpoint_numbers_gives_the_strings(
    scan: SimulatedScan, clouds: list[Points], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    points = np.vstack(clouds)
    normals = np.tile((0.0, 0.0, 1.0), (len(points), 1))
    file, out = write_ply(tmp_path / "all.ply", points, normals=normals), tmp_path / "out.mcap"
    assert main(["import", "cloud", file, str(out), *options(scan)]) == 0
    err = capsys.readouterr().err
    assert "all.ply: these properties were ignored: nx, ny, nz" in err
    assert "8 virtual views, by one merged file" in err
    assert checked_distance_m(out, scan) < 2e-4


def test_hidden_points_are_not_visible(tmp_path: Path) -> None:
    """Put a plate above the table, which hides the table below it from each viewpoint."""
    x, y = (a.ravel() for a in np.meshgrid(np.arange(-0.2, 0.2, 0.002), np.arange(-0.2, 0.2, 0.002)))
    table = np.column_stack([x, y, np.zeros_like(x)])
    plate = table[(np.abs(x) < 0.05) & (np.abs(y) < 0.05)] + (0.0, 0.0, 0.05)
    file, out = write_ply(tmp_path / "all.ply", np.vstack([table, plate])), tmp_path / "out.mcap"
    eyes = ["--viewpoint", "0.1", "0", "0.5", "--viewpoint", "-0.1", "0", "0.5"]
    assert main(["import", "cloud", file, str(out), *eyes]) == 0
    for view in read_recording(out).views:
        points = deproject(view, *np.nonzero(view.depth))
        height = points[:, 2]
        assert np.minimum(np.abs(height), np.abs(height - 0.05)).max() < 5e-3
        eye = view.T_base_camera[:3, 3]
        at_plate = eye + (points - eye) * ((0.05 - eye[2]) / (points[:, 2] - eye[2]))[:, None]  # rays at its height
        hidden = (np.abs(at_plate[:, :2]) < 0.045).all(axis=1) & (np.abs(height) < 0.005)
        assert hidden.sum() == 0


Change = Callable[[Path, Points], list[str]]


def one(change: Callable[[Points], Points]) -> Change:
    return lambda folder, points: [write_ply(folder / "all.ply", change(points))]


def text(content: str) -> Change:
    def write(folder: Path, _: Points) -> list[str]:
        (folder / "all.ply").write_text(content)
        return [str(folder / "all.ply")]

    return write


def cut_off(folder: Path, points: Points) -> list[str]:
    path = Path(write_ply(folder / "all.ply", points))
    path.write_bytes(path.read_bytes()[:-1000])
    return [str(path)]


def numbered(first: int) -> Change:
    return lambda folder, points: [
        write_ply(folder / "all.ply", points, view=np.arange(len(points), dtype=np.int32) % 8 + first)
    ]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda folder, points: [write_ply(folder / f"{k}.ply", points) for k in range(3)], "3 files and 8 viewpoints"),
        (one(lambda points: points[::2000]), "1000 at least are needed"),
        (one(lambda points: points * 1000), "these look like millimetres"),
        (one(lambda points: points + (0, 0, 0.1)), "0% of the points are at the table, z = 0 m, and 20% are needed"),
        (one(lambda points: points[points[:, 2] > 0.003]), "keep the table's points"),
        (one(lambda points: points * np.nan), "has no points with finite coordinates"),
        (one(lambda points: np.random.default_rng(0).permutation(points)[:1500]), "the points are too sparse"),
        (text("solid"), "is not a PLY file"),
        (text("ply\nformat ascii 1.0\nelement vertex 0\nend_header\n"), "has no points: an element vertex"),
        (lambda folder, _: [str(folder / "none.ply")], "cannot be read: No such file"),
        (cut_off, "is damaged or cut off"),
        (numbered(1), "numbers its viewpoints 1, 2, 3, 4, 5, 6, 7, 8; with 8 viewpoints given, 0 to 7 are needed"),
    ],
)
def test_bad_clouds_are_rejected(
    scan: SimulatedScan,
    clouds: list[Points],
    tmp_path: Path,
    change: Change,
    message: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = tmp_path / "out" / "out.mcap"
    out.parent.mkdir()
    files = change(tmp_path, np.vstack(clouds))
    assert main(["import", "cloud", *files, str(out), *viewpoints(scan), "--radius=0.0042"]) == 1
    assert message in capsys.readouterr().err
    assert list(out.parent.iterdir()) == []


@pytest.mark.parametrize(
    ("eyes", "message"),
    [
        ([(0, 0, 0.5 + 0.001 * k) for k in range(65)], "65 viewpoints are given; from 1 to 64 are needed"),
        ([(0, 0, 0.5), (0, 0.1, -0.5)], "is not above the table, z = 0 m"),
        ([(0, 0, 0.5), (0, 0, 0.5)], "two viewpoints are the same"),
        ([(0, 0, 0.5), (0, 0, float("nan"))], "has NaN or infinity"),
        ([(0, 0, 0.5), (0, 0, 0.01)], "inside the cloud"),
        ([(0, 0, 0.5), (0, 0.0, 0.05)], "inside the cloud"),
    ],
)
def test_bad_viewpoints_are_rejected(
    eyes: list[tuple[float, ...]],
    message: str,
    clouds: list[Points],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    file, out = write_ply(tmp_path / "all.ply", clouds[0]), tmp_path / "out.mcap"
    arguments = [text for eye in eyes for text in ("--viewpoint", *map(str, eye))]
    assert main(["import", "cloud", file, str(out), *arguments]) == 1
    assert message in capsys.readouterr().err
    assert not out.exists()


def test_nothing_is_overwritten_and_a_missing_property_is_named(
    scan: SimulatedScan, clouds: list[Points], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, out = write_ply(tmp_path / "all.ply", clouds[0]), tmp_path / "out.mcap"
    out.write_text("mine")
    assert main(["import", "cloud", file, str(out), *options(scan)]) == 1
    assert "nothing is overwritten" in capsys.readouterr().err
    assert out.read_text() == "mine"
    assert main(["import", "cloud", file, str(tmp_path / "n.mcap"), *options(scan), "--view-property=scan"]) == 1
    assert "has no property 'scan'" in capsys.readouterr().err


def test_a_mesh_gives_its_points(scan: SimulatedScan, clouds: list[Points], tmp_path: Path) -> None:
    from cell.cloud.ply_file import read_cloud

    rows = "".join(f"{x} {y} {z}\n" for x, y, z in clouds[0][:4])
    head = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    path = tmp_path / "mesh.ply"
    path.write_text(f"{head}element face 1\nproperty list uchar int vertex_indices\nend_header\n{rows}3 0 1 2\n")
    cloud = read_cloud(path)
    np.testing.assert_allclose(cloud.points, clouds[0][:4], atol=1e-6)
    assert cloud.notes == ("mesh.ply is a mesh: its face elements were ignored",)
