"""A request that a lenient service would misread is refused, with the reason."""

from collections.abc import Callable, Iterator
from typing import Any

import httpx2
import pytest

from service.app import create_app
from service.config.loader import ServiceConfig
from tests.service.conftest import Serve, ServedClient
from tests.service.security.conftest import without_recognition

AssertProblem = Callable[[httpx2.Response, int, str], str]


@pytest.fixture(scope="module")
def roomy(serve: Serve, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServedClient]:
    """Yield a client of a service with the default limits: the shared one refuses some bodies for their size."""
    with without_recognition(serve, tmp_path_factory.mktemp("data")) as client:
        yield client


@pytest.mark.parametrize(
    ("body", "reason"),
    [
        (b'{"views": ' + b"[" * 20_000 + b"]" * 20_000 + b"}", "too many lists or objects inside one another"),
        (b'{"views": ' + b"9" * 5000 + b"}", "has an integer of more than 4300 digits"),
        (b'{"views": "\xff"}', "not UTF-8, as JSON must be (RFC 8259): invalid start byte at byte 11"),
        ('{"views": 3}'.encode("utf-16"), "is UTF-16: JSON must be UTF-8"),
        ('{"views": 3}'.encode("utf-16-le"), "is UTF-16-LE: JSON must be UTF-8"),
        ('{"views": 3}'.encode("utf-32"), "is UTF-32: JSON must be UTF-8"),
    ],
    ids=["deep", "long integer", "not UTF-8", "UTF-16", "UTF-16 without a mark", "UTF-32"],
)
@pytest.mark.problem("bad-request")
def test_a_body_that_cannot_be_read_is_refused_with_the_reason(
    roomy: ServedClient, assert_problem: AssertProblem, body: bytes, reason: str
) -> None:
    answer = roomy.post("/api/viewpoints/plan", content=body, headers={"Content-Type": "application/json"})
    assert reason in assert_problem(answer, 400, "bad-request")


def requests() -> Iterator[Any]:
    """Yield the schemas of the objects in each JSON request of the description."""
    document = create_app(ServiceConfig()).openapi()
    schemas = document["components"]["schemas"]

    def resolve(schema: dict[str, Any]) -> Iterator[dict[str, Any]]:
        if "$ref" in schema:
            yield from resolve(schemas[schema["$ref"].rpartition("/")[2]])
        for choice in (*schema.get("anyOf", ()), *schema.get("oneOf", ())):
            yield from resolve(choice)
        if schema.get("type") == "object":
            yield schema
            for member in schema["properties"].values():
                yield from resolve(member)

    for path, item in document["paths"].items():
        for method, operation in item.items():
            content = operation.get("requestBody", {}).get("content", {}).get("application/json")
            if content is not None:
                yield pytest.param(list(resolve(content["schema"])), id=f"{method.upper()} {path}")


@pytest.mark.parametrize("schemas", list(requests()))
def test_no_request_has_members_that_are_not_described(schemas: list[dict[str, Any]]) -> None:
    assert schemas
    for schema in schemas:
        assert schema["additionalProperties"] is False, schema["title"]


@pytest.mark.problem("invalid-request")
def test_a_misspelt_member_is_refused(client: ServedClient, assert_problem: AssertProblem) -> None:
    answer = client.post("/api/viewpoints/plan", json={"veiws": 3})
    assert assert_problem(answer, 422, "invalid-request") == "body.veiws: there is no such member"
