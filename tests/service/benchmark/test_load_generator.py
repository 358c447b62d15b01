"""The clients that a benchmark sets on a service: what they tell of it."""

import json
import time

import pytest

from service.benchmark.load_generator import Load, Wanted, asking, length_of
from tests.service.conftest import ServedClient, wait_until


def test_what_is_met_is_counted(client: ServedClient) -> None:
    port = client.base_url.port
    assert port is not None
    mix = [Wanted("lists", "/api/scans"), Wanted("none", "/api/scans/none", 404), Wanted("wrong", "/healthz", 304)]
    with asking(Load(port, connections=2, requests=mix, pause_s=0.01, streams=4)) as met:
        wait_until(lambda: client.app.state.context.streams.open == 4)
        time.sleep(0.5)  # each asks some times
    assert set(met["seconds"]) == {"lists", "none", "wrong"}
    assert all(seconds > 0 for times in met["seconds"].values() for seconds in times)
    assert set(met["wrong"]) == {"/healthz: 200 instead of 304"}
    assert len(met["wrong"]) == len(met["seconds"]["wrong"])
    assert met["duration_s"] >= 0.5
    assert (met["let_in"], met["refused"]) == (4, 0)


def test_a_load_goes_to_another_process_as_it_is() -> None:
    load = Load(8000, 3, [Wanted("model", "/api/scans/x/model", 304, '"tag"')], pause_s=0.1, streams=2)
    assert Load.from_json(load.to_json()) == load
    assert b'\r\nIf-None-Match: "tag"\r\n' in load.requests[0].request(8000)
    assert json.loads(load.to_json())["port"] == 8000


@pytest.mark.parametrize(
    ("head", "length"),
    [
        (b"HTTP/1.1 200 OK\r\nContent-Length: 17\r\nETag: x", 17),
        (b"HTTP/1.1 200 OK\r\ncontent-length: 5", 5),
        (b"HTTP/1.1 304 Not Modified\r\nETag: x", 0),
    ],
)
def test_an_answer_is_as_long_as_it_says(head: bytes, length: int) -> None:
    assert length_of(head) == length
