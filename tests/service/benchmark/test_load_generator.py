"""The load generator sends requests to a service and reports the answers."""

import json

import pytest

from service.benchmark.load_generator import Load, LoadRequest, content_length, run_load
from tests.service.conftest import ServedClient, metric_values, wait_until


def test_answers_and_streams_are_counted(client: ServedClient) -> None:
    port = client.base_url.port
    assert port is not None
    mix = [
        LoadRequest("lists", "/api/scans"),
        LoadRequest("none", "/api/scans/none", 404),
        LoadRequest("wrong", "/healthz", 304),
    ]
    before = answers(client, "/healthz")
    with run_load(Load(port, connections=2, requests=mix, pause_s=0.01, streams=4)) as results:
        wait_until(lambda: client.app.state.context.streams.open == 4)
        # Both clients go through the mix. When its last request was answered four times, each answer has arrived once.
        wait_until(lambda: answers(client, "/healthz") >= before + 4)
    assert set(results["seconds"]) == {"lists", "none", "wrong"}
    assert all(seconds > 0 for times in results["seconds"].values() for seconds in times)
    assert set(results["wrong"]) == {"/healthz: 200 instead of 304"}
    assert len(results["wrong"]) == len(results["seconds"]["wrong"])
    assert results["duration_s"] > 0
    assert (results["let_in"], results["refused"]) == (4, 0)


def answers(client: ServedClient, route: str) -> float:
    """Return how many requests of a route the service has answered, with any method and status."""
    return sum(
        value
        for (name, labels), value in metric_values(client).items()
        if name == "pointchain_http_requests_total" and ("route", route) in labels
    )


def test_a_load_is_unchanged_by_its_json_form() -> None:
    load = Load(8000, 3, [LoadRequest("model", "/api/scans/x/model", 304, '"tag"')], pause_s=0.1, streams=2)
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
def test_the_content_length_is_read_from_the_head(head: bytes, length: int) -> None:
    assert content_length(head) == length
