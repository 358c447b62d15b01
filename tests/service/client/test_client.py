"""The client against the real service: its results and its errors."""

import os
import signal
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import pytest

from pointchain_client import Client, ProblemError, ScanFailedError, ScanProgress, UnansweredError, UnreachableError
from tests.service.client.answers import KINDS, open_planner
from tests.service.conftest import PATIENCE_S, Serve, wait_until


@pytest.fixture(params=KINDS)
def kind(request: pytest.FixtureRequest) -> str:
    """Kind of the client under test."""
    return request.param


@pytest.fixture
def planner(kind: str, client: httpx2.Client) -> Iterator[Client]:
    with open_planner(kind, str(client.base_url)) as planner:
        yield planner


def test_a_recording_becomes_a_model_with_arrays(planner: Client, recording_file: Path) -> None:
    seen: list[ScanProgress] = []
    scan = planner.replay(recording_file, on_progress=seen.append, timeout_s=PATIENCE_S)
    assert scan.state == "succeeded"
    assert (seen[-1].state, seen[-1].ended, seen[-1].fraction) == ("succeeded", True, 1.0)
    assert [progress.fraction for progress in seen] == sorted(progress.fraction for progress in seen)
    model = planner.model(scan)
    (chain,) = model.chains
    assert chain.points.shape == (len(chain.sigma_m), 3)
    assert np.linalg.norm(np.diff(chain.points, axis=0), axis=1).sum() == pytest.approx(chain.length_m, abs=1e-5)
    assert planner.get(scan.id) == scan
    assert next(planner.scans(mode="replay", state="succeeded")).id == scan.id
    # waiting for an ended scan returns the same
    assert planner.wait(scan.id) == scan


def test_the_model_says_which_positions_are_trusted(planner: Client, recording: str) -> None:
    """With 6 mm as radius of the string of 4.2 mm, the model has a doubt about its only chain."""
    scan = planner.replay(recording, timeout_s=PATIENCE_S)
    model = planner.model(scan)
    assert model.trusted(0)
    assert all(grasp.trusted and model.trusted(grasp.chain, grasp.s_m) for grasp in model.grasps)
    with pytest.raises(KeyError):
        model.trusted(1)
    scan = planner.replay(recording, string_radius_m=0.006, timeout_s=PATIENCE_S)
    assert scan.summary is not None
    assert (scan.all_grasps, scan.summary.verdict) == (False, "review")
    model = planner.model(scan)
    assert [found.code for found in model.quality.doubts] == [found.code for found in scan.summary.doubts]
    assert not model.trusted(0)
    assert not model.trusted(0, model.chains[0].length_m / 2)
    assert model.grasps == ()
    scan = planner.replay(recording, string_radius_m=0.006, all_grasps=True, timeout_s=PATIENCE_S)
    assert scan.all_grasps
    model = planner.model(scan)
    assert model.grasps
    assert not any(grasp.trusted or model.trusted(grasp.chain, grasp.s_m) for grasp in model.grasps)


def test_a_model_has_its_changes_since_another_scan(planner: Client, recording: str) -> None:
    before = planner.replay(recording, timeout_s=PATIENCE_S)
    scan = planner.replay(recording, timeout_s=PATIENCE_S)
    model = planner.model(scan)
    assert model.since is None
    found = [
        planner.model(scan, since=before).since,
        planner.changes(scan, since=before),
        planner.changes(scan.id, since=before.id),
        planner.changes(model, since=planner.model(before)),
    ]
    for changes in found:
        assert changes is not None
        assert (changes.scan, changes.new, changes.gone) == (before.id, (), ())
        (match,) = changes.matches
        assert (match.chain, match.before, match.change, match.is_reversed) == (0, 0, "unmoved", False)
        assert match.T_now_before.tolist() == np.eye(4).tolist()
    with pytest.raises(ProblemError) as unknown:
        planner.changes(scan, since="20260101t000000-000000-00000000")
    assert unknown.value.slug == "scan-not-found"
    without = replace(model, provenance=None)
    with pytest.raises(ValueError, match="does not say from which scan"):
        planner.changes(without, since=before)


def test_grasps_are_listed_filtered_and_checked_for_reach(planner: Client, recording: str) -> None:
    scan = planner.replay(recording, timeout_s=PATIENCE_S)
    model = planner.model(scan)
    found = planner.grasps(scan)
    assert (found.schema, found.frame, found.total, found.q_home_rad) == (
        "pointchain/2",
        "base",
        len(model.grasps),
        None,
    )
    assert [grasp.id for grasp in found.grasps] == [grasp.id for grasp in model.grasps]
    assert {grasp.reach for grasp in found.grasps} == {None}, "the reach of a recording is determined on request"
    assert found.reachable == ()
    for grasp, of_model in zip(found.grasps, model.grasps, strict=True):
        tip = (grasp.T_base_flange.grasp @ found.T_flange_tcp)[:3, 3]
        # the fingertips are `reach_m` beyond the centre line
        wanted = grasp.T_base_grasp[:3, 3] + grasp.reach_m * grasp.T_base_grasp[:3, 2]
        np.testing.assert_allclose(tip, wanted, rtol=0, atol=2e-6)
        assert grasp.T_base_grasp.tolist() == of_model.T_base_grasp.tolist()
    middle = model.chains[0].length_m / 2
    some = planner.grasps(model, chain=0, s_range_m=(middle, 1.0), min_clearance_m=0.02, count=4)
    wanted_ids = [grasp.id for grasp in model.grasps if grasp.s_m >= middle and grasp.clearance_m >= 0.02]
    assert [grasp.id for grasp in some.grasps] == wanted_ids[:4]
    assert some.total == found.total

    # the string lies at the origin, where the base of the arm is
    checked = planner.grasps(scan.id, reach=True, count=3)
    assert checked.q_home_rad is not None
    assert checked.q_home_rad.shape == (6,)
    for grasp in checked.grasps:
        assert grasp.reach is not None
        assert (grasp.reach.reachable, grasp.reach.q_grasp_rad, grasp.reach.path_free) == (False, None, None)
        assert grasp.reach.reason
        assert grasp.reach.message
    assert planner.grasps(scan, reachable=True).grasps == ()
    reason = planner.grasps(scan, reach=False).no_reach_reason
    assert reason is not None
    assert reason.startswith("the scan is a recording that names no calibration")
    assert len(planner.grasps(scan, reachable=False, count=2).grasps) == 2
    after = planner.grasps(scan, chain=0, s_range_m=(middle, None))
    assert [grasp.id for grasp in after.grasps] == [grasp.id for grasp in model.grasps if grasp.s_m >= middle]
    before = planner.grasps(scan, chain=0, s_range_m=(None, middle))
    assert [grasp.id for grasp in before.grasps] == [grasp.id for grasp in model.grasps if grasp.s_m <= middle]
    assert after.grasps
    assert before.grasps
    refused: list[dict[str, Any]] = [{"chain": 7}, {"s_range_m": (0.1, 0.2)}, {"reachable": True, "reach": False}]
    for filters in refused:
        with pytest.raises(ProblemError) as error:
            planner.grasps(scan, **filters)
        assert error.value.slug == "invalid-parameters"


@pytest.mark.parametrize("given", [0.1, (0.1,), (0.1, 0.2, 0.3), (), ("far", None)])
def test_a_range_that_is_no_pair_is_refused(planner: Client, given: Any) -> None:
    with pytest.raises(ValueError, match=r"s_range_m is .*; it must be two arc lengths in metres, for example"):
        planner.grasps("20260101t000000-000000-00000000", chain=0, s_range_m=given)


def test_the_height_map_shows_the_string_on_the_table(planner: Client, recording: str) -> None:
    scan = planner.replay(recording, timeout_s=PATIENCE_S)
    assert scan.links.height_map is not None
    heights = planner.height_map(scan)
    (chain,) = planner.model(scan).chains
    assert heights.frame == "base"
    cells = np.floor((chain.points[:, :2] - (heights.x_m, heights.y_m)) / heights.cell_m).astype(int)
    above_m = heights.z_m[*cells.T] - heights.table_z_m
    # the string is 8.4 mm thick; cells at its edge are lower
    assert 0.006 < np.nanmedian(above_m) < 0.0095
    assert heights.min_object_height_m >= 0.0012
    rest = np.nanmedian(heights.z_m)
    assert rest == pytest.approx(heights.table_z_m, abs=0.0005), "most of the cells are the table"
    assert np.isnan(heights.z_m).any(), "the map is wider than what the views show"


def test_a_scan_is_reprocessed_kept_and_deleted(planner: Client, recording: str) -> None:
    scan = planner.replay(recording, string_radius_m=0.004, timeout_s=PATIENCE_S)
    again = planner.reprocess(scan, {"method": "matching", "string_radius_m": None}, timeout_s=PATIENCE_S)
    assert (again.source, again.method, again.string_radius_m) == (scan.id, "matching", None)
    assert planner.reprocess(planner.model(scan), timeout_s=PATIENCE_S).string_radius_m == 0.004
    assert planner.keep(scan).kept
    with pytest.raises(ProblemError) as kept:
        planner.delete(scan)
    assert kept.value.slug == "scan-kept"
    assert not planner.keep(scan.id, kept=False).kept
    planner.delete(scan)
    with pytest.raises(ProblemError) as unknown:
        planner.get(scan.id)
    assert unknown.value.slug == "scan-not-found"


def test_a_recording_can_be_uploaded_from_a_text_path(planner: Client, recording_file: Path) -> None:
    assert planner.upload(str(recording_file)).sha256 == planner.upload(recording_file).sha256


def test_scans_reads_all_pages(planner: Client, recording: str) -> None:
    ids = [planner.replay(recording, timeout_s=PATIENCE_S).id for _ in range(3)]
    assert [scan.id for scan in planner.scans(recording=recording, limit=2)] == ids[::-1]


def test_the_same_key_starts_one_scan(kind: str, planner: Client, recording: str) -> None:
    request, key = {"mode": "replay", "recording": recording}, f"the same {kind}"
    first = planner.start(request, key=key)
    assert planner.start(request, key=key).id == first.id
    assert planner.wait(first, timeout_s=PATIENCE_S).id == first.id
    with pytest.raises(ProblemError) as mismatch:
        planner.start(request | {"method": "matching"}, key=key)
    assert mismatch.value.slug == "idempotency-mismatch"


def test_a_request_is_checked_without_a_scan(planner: Client, recording: str) -> None:
    request = {"mode": "replay", "recording": recording, "string_radius_m": 0.004}
    found = planner.validate(request)
    assert (found.valid, found.recording, found.string_radius_m, found.viewpoints) == (True, recording, 0.004, None)
    assert list(planner.scans(recording=recording)) == []
    with pytest.raises(ProblemError) as refused:
        planner.validate(request | {"recording": "20260101t000000-000000-00000000"})
    assert refused.value.slug == "recording-not-found"
    with pytest.raises(ValueError, match="use validate"):
        planner.start(request | {"validate_only": True})


def test_refusals_and_failures_have_a_reason(planner: Client, recording: str, held: int) -> None:
    with pytest.raises(ProblemError) as unknown:
        planner.replay("20260101t000000-000000-00000000")
    assert unknown.value.slug == "recording-not-found"
    with pytest.raises(ValueError, match="pass a file as Path"):
        planner.replay("knot.mcap")
    scan = planner.start({"mode": "replay", "recording": recording})
    with pytest.raises(TimeoutError, match="and continues"):
        planner.wait(scan, timeout_s=0.3)
    for read in (planner.model, planner.grasps, planner.height_map):
        with pytest.raises(ScanFailedError, match=r"is (queued|processing)"):
            read(scan)
    assert planner.cancel(scan).state == "aborted"
    with pytest.raises(ScanFailedError, match="was cancelled") as failed:
        planner.wait(scan)
    assert failed.value.slug == "aborted"
    assert failed.value.scan.state == "aborted"


def test_without_a_stream_the_client_polls(kind: str, serve: Serve, recording_file: Path, tmp_path: Path) -> None:
    with (
        serve(tmp_path / "data", limits={"event_streams": 1}) as service,
        open_planner(kind, str(service.base_url)) as planner,
    ):
        uploaded = planner.upload(recording_file)
        assert uploaded.name == recording_file.name
        recording = uploaded.id
        with service.stream("GET", "/api/events") as stream:
            next(stream.iter_lines())
            seen: list[ScanProgress] = []
            assert planner.replay(recording, on_progress=seen.append, timeout_s=PATIENCE_S).state == "succeeded"
        assert seen[-1].ended


def test_an_address_without_a_scheme_is_refused(kind: str) -> None:
    with pytest.raises(ValueError, match="begins with http://"), open_planner(kind, "127.0.0.1:8000"):
        pass


def test_an_unreachable_service_is_reported(kind: str, recording_file: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as occupied:
        address = f"http://127.0.0.1:{occupied.getsockname()[1]}"
    with open_planner(kind, address) as planner:
        with pytest.raises(UnreachableError, match="nothing was started"):
            planner.scan()
        with pytest.raises(UnreachableError, match="use the robot's own"):
            planner.stop()
        with pytest.raises(UnreachableError, match="does not answer"):
            planner.cell()
        with pytest.raises(UnreachableError, match="did not accept the recording"):
            planner.upload(recording_file)


def test_a_lost_answer_has_the_key_that_finds_the_scan(
    kind: str, planner: Client, client: httpx2.Client, recording: str
) -> None:
    with (
        cutting_proxy(client.base_url.port or 80, after_bytes=0) as port,
        open_planner(kind, f"http://127.0.0.1:{port}") as proxied,
        pytest.raises(UnansweredError) as lost,
    ):
        proxied.replay(recording)
    before = len(list(planner.scans(recording=recording)))
    scan = planner.wait(planner.start(lost.value.request, lost.value.key), timeout_s=PATIENCE_S)
    assert before == 1, "the request had arrived, though its answer had not"
    assert [other.id for other in planner.scans(recording=recording)] == [scan.id]


def test_wait_survives_lost_connections(kind: str, client: httpx2.Client, recording: str, held: int) -> None:
    """Each connection breaks after some bytes; no change of the state is missed."""
    with (
        cutting_proxy(client.base_url.port or 80, after_bytes=3000) as port,
        open_planner(kind, f"http://127.0.0.1:{port}") as planner,
    ):
        scan = planner.start({"mode": "replay", "recording": recording})
        seen: list[ScanProgress] = []

        # recognition continues at the first progress, so that all later changes come through broken connections
        def see(progress: ScanProgress) -> None:
            if not seen:
                os.kill(held, signal.SIGCONT)
            seen.append(progress)

        assert planner.wait(scan, on_progress=see, timeout_s=PATIENCE_S).state == "succeeded"
    assert seen[-1].state == "succeeded"


@contextmanager
def cutting_proxy(port: int, after_bytes: int) -> Iterator[int]:
    """Yield the port of a proxy to `port` that cuts a connection after `after_bytes` bytes of answers.

    Each connection carries one request. Shorter answers come through whole.
    """
    ending = threading.Event()

    def carry(near: socket.socket) -> None:
        with near, socket.create_connection(("127.0.0.1", port)) as far:
            threading.Thread(target=pass_on, args=(near, far), daemon=True).start()
            back = 0
            while received := far.recv(1024):
                back += len(received)
                if back > after_bytes:
                    near.shutdown(socket.SHUT_RDWR)
                    far.shutdown(socket.SHUT_RDWR)
                    return
                near.sendall(received)

    def pass_on(near: socket.socket, far: socket.socket) -> None:
        try:
            while received := near.recv(1024):
                far.sendall(received)
        except OSError:
            return  # cut

    def accept(listening: socket.socket) -> None:
        while not ending.is_set():
            try:
                near, _ = listening.accept()
            except TimeoutError:
                continue
            threading.Thread(target=carry, args=(near,), daemon=True).start()

    with socket.create_server(("127.0.0.1", 0)) as listening:
        listening.settimeout(0.1)
        thread = threading.Thread(target=accept, args=(listening,))
        thread.start()
        try:
            yield listening.getsockname()[1]
        finally:
            ending.set()
            thread.join()


def test_stop_is_repeated_after_the_connection_was_closed(kind: str, client: httpx2.Client) -> None:
    with open_planner(kind, str(client.base_url)) as planner:
        planner.stop()
        assert planner.cell().state == "not_ready"
        wait_until(lambda: planner.cell().state != "busy")
