import numpy as np
import pytest

from cell.simulation.benchmark.reference import contribution_rates, estimate_centre_line, recognise_literally, thin
from cell.simulation.benchmark.reference_matching import match_enhanced
from cell.simulation.benchmark.reference_reconstruction import reconstruct
from cell.simulation.evaluation.metrics import score
from cell.simulation.offline_scan import simulate
from cell.simulation.pose_errors import NO_ERRORS
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.scenes import make_scene
from recognition.parameters import ChainParameters
from recognition.preprocessing.target_cloud import Scene

R = 0.0042
PARAMETERS = ChainParameters.for_radius(R)


def strand(start: tuple[float, float], end: tuple[float, float], width_m: float = 0.0) -> np.ndarray:
    """Return points every 0.4 mm from start to end on the table, scattered sideways by up to half of the width."""
    a, b = np.array([*start, 0.0]), np.array([*end, 0.0])
    count = int(np.linalg.norm(b - a) / 0.0004) + 1
    points = np.linspace(a, b, count)
    across = np.cross(b - a, [0.0, 0.0, 1.0]) / np.linalg.norm(b - a)
    return points + width_m * np.random.default_rng(1).uniform(-0.5, 0.5, (count, 1)) * across


def test_the_baseline_finds_a_string_in_views_without_noise() -> None:
    scene = make_scene("arc", 1)
    scan = simulate(scene, camera_model("exact", (240, 150)), 1, NO_ERRORS, views=4)
    chains = recognise_literally(scan.views, PARAMETERS, Scene(scan.header.table_z_m, scan.header.workspace_m))
    model = {"chains": [{"id": k, "points": chain} for k, chain in enumerate(chains)], "crossings": []}
    result = score(model, scan.truth)
    assert result.topology
    # The averaging of the paper moves each end inwards by about 2 r of 400 mm. At the last point, a further length of
    # at most r_f is missing. It depends on the order of equal distances, which differs between processors.
    assert result.cover > 0.95
    assert result.end_m is not None
    assert R <= result.end_m <= 2 * R + PARAMETERS.r_f
    assert result.mean_m is not None
    assert result.mean_m < 0.001


def test_without_views_there_are_no_chains() -> None:
    assert recognise_literally([], PARAMETERS, Scene()) == []


def test_the_centre_line_of_a_tube_is_its_axis() -> None:
    s, angle = (grid.ravel() for grid in np.meshgrid(np.linspace(0, 0.1, 80), np.linspace(0, 2 * np.pi, 16, False)))
    normals = np.column_stack([np.zeros_like(s), np.cos(angle), np.sin(angle)])
    points = np.column_stack([s, np.zeros_like(s), np.zeros_like(s)]) + R * normals
    centre_line = estimate_centre_line(points, normals, PARAMETERS)
    # Eq. (1) with exact normals is exact, and eq. (2) averages along the axis.
    assert np.abs(centre_line[:, 1:]).max() < 1e-12
    assert len(centre_line) > 0.9 * len(points)


def test_thinning_narrows_a_band() -> None:
    band = strand((0.0, 0.0), (0.1, 0.0), width_m=0.004)
    assert np.ptp(thin(band, PARAMETERS)[:, 1]) < 0.5 * np.ptp(band[:, 1])


def test_the_contribution_rate_differs_between_a_line_and_a_disc() -> None:
    line = strand((0.0, 0.0), (0.02, 0.0))
    assert contribution_rates(line, PARAMETERS) == pytest.approx(np.ones(len(line)))
    x, y = (grid.ravel() for grid in np.meshgrid(*[np.linspace(-R, R, 41)] * 2))
    disc = np.column_stack([x, y, 0 * x])
    middle = contribution_rates(disc, PARAMETERS)[len(disc) // 2]
    # The two eigenvalues of a disc are equal.
    assert middle == pytest.approx(0.5, abs=1e-6)
    assert contribution_rates(np.zeros((1, 3)), PARAMETERS) == [1.0]


def test_two_merged_strands_are_separated() -> None:
    # The patch around the crossing is as wide as the gap between the strands in Fig. 8 (b) of the paper.
    x, y = (grid.ravel() for grid in np.meshgrid(*[np.arange(-0.008, 0.008, 0.0006)] * 2))
    patch = np.column_stack([x, y, 0 * x])[np.hypot(x, y) < 0.008]
    cloud = np.vstack([strand((-0.06, 0.0), (0.06, 0.0)), strand((0.0, -0.05), (0.0, 0.05)), patch])
    segments, centres = match_enhanced(cloud, contribution_rates(cloud, PARAMETERS), PARAMETERS)
    assert len(centres) == 1
    # The centre is in the middle of the patch, to the maximum distance of a link.
    assert np.linalg.norm(cloud[centres[0]]) < PARAMETERS.r_f
    chains = reconstruct([cloud[segment] for segment in segments], cloud[centres], PARAMETERS)
    assert len(chains) == 2
    extents = sorted(np.ptp(chain, axis=0)[:2].tolist() for chain in chains)
    # One chain runs along y, the other along x. At each end, up to one link of r to 2 r may be missing.
    assert extents[0] == pytest.approx([0.0, 0.1], abs=4 * R)
    assert extents[1] == pytest.approx([0.12, 0.0], abs=4 * R)


def test_close_ends_are_connected_and_far_ones_are_not() -> None:
    a, b, c = strand((0.0, 0.0), (0.03, 0.0)), strand((0.036, 0.0), (0.06, 0.0)), strand((0.08, 0.0), (0.1, 0.0))
    # b is reversed, so that its last point is near a.
    chains = reconstruct([a, b[::-1], c], np.zeros((0, 3)), PARAMETERS)
    assert sorted(len(chain) for chain in chains) == [len(c), len(a) + len(b)]
    joined = max(chains, key=len)
    assert (np.abs(np.diff(joined[:, 0])) < 0.0065).all()


def test_ends_around_a_bifurcation_centre_are_connected_straight() -> None:
    gap = 0.013
    arms = [strand((gap * x, gap * y), (0.05 * x, 0.05 * y)) for x, y in ((1, 0), (0, 1), (-1, 0), (0, -1))]
    chains = reconstruct(arms, np.zeros((1, 3)), PARAMETERS)
    assert len(chains) == 2
    for chain in chains:
        assert np.linalg.norm(chain[0] + chain[-1]) < 1e-9, "each arm continues in the opposite arm"


def test_no_ring_is_closed() -> None:
    angle = np.linspace(0.1, 2 * np.pi - 0.1, 200)
    ring = 0.03 * np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    (chain,) = reconstruct([ring], np.zeros((0, 3)), PARAMETERS)
    assert chain == pytest.approx(ring)
