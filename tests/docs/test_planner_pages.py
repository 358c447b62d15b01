"""The planner's pages have every member of the model, every call and every exception of the client."""

import json
import re
from typing import Any, get_args

from pydantic import TypeAdapter

import pointchain_client
from cell.planning.grasp_reach import ReachReason
from recognition.model.document import ModelDocument
from recognition.model.model import PointChainModel
from service.api.schemas.grasps import GraspsDocument
from service.api.schemas.scans import HeightMapDocument
from service.security.auth.roles import MIN_ROLE
from tests.docs.pages import DOCS, ROOT, blocks

PLANNER = DOCS / "planner"
UNLISTED = ("/docs", "/openapi", "/static", "/console", "/manual", "/ ")
"""Beginnings of paths that only people and browsers call."""


def members(schema: dict[str, Any]) -> set[str]:
    """Return the names of all members in a JSON schema."""
    found = set(schema.get("properties", {}))
    return found.union(*(members(part) for part in schema.get("$defs", {}).values()))


def test_each_member_of_the_model_is_explained() -> None:
    text = "".join((PLANNER / name).read_text() for name in ("model.md", "findings.md"))
    prose = re.sub(r"```.*?```", "", text, flags=re.DOTALL)
    explained = set(re.findall(r"`([A-Za-z_][A-Za-z_0-9]*)`", prose))
    schema = TypeAdapter(ModelDocument).json_schema()
    assert members(schema) - explained == set()


def test_each_member_of_the_list_of_grasps_is_explained() -> None:
    """The members of a grasp of the model are explained on the page of the model."""
    text = "".join((PLANNER / name).read_text() for name in ("model.md", "http.md", "grasps.md"))
    explained = set(re.findall(r"`([A-Za-z_][A-Za-z_0-9]*)`", re.sub(r"```.*?```", "", text, flags=re.DOTALL)))
    for kind in (GraspsDocument, HeightMapDocument):
        schema = TypeAdapter(kind).json_schema()
        assert members(schema) - explained == set()


def test_each_parameter_of_the_grasps_is_in_the_table() -> None:
    table = section("http.md", "### Get the grasps")
    given = {name for row in table for name in re.findall(r"`(\w+)`", row[0])}
    description = json.loads((ROOT / "service/openapi.json").read_text())
    parameters = description["paths"]["/api/scans/{id}/grasps"]["get"]["parameters"]
    assert given == {parameter["name"] for parameter in parameters if parameter["in"] == "query"}


def test_each_reason_against_the_reach_is_in_the_table() -> None:
    given = {row[0].strip("`") for row in section("grasps.md", "## Reach")}
    assert set(get_args(ReachReason)) - given == set()


def section(page: str, heading: str) -> list[list[str]]:
    """Return the rows of the tables below a heading."""
    text = (PLANNER / page).read_text().split(f"\n{heading}\n")[1].split("\n## ")[0].split("\n### ")[0]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines() if line[:1] == "|"]


def test_the_example_is_a_model() -> None:
    (example,) = [block for block in blocks(PLANNER / "model.md") if block.language == "json"]
    document = json.loads(example.text)
    model = PointChainModel.from_json(document)
    assert model.gauss_code() == document["topology"]["gauss_code"]
    assert set(document["parameters"]) == set(model.to_json()["parameters"])


def test_each_call_is_in_the_table_with_its_role() -> None:
    table = (PLANNER / "http.md").read_text().split("## All calls")[1]
    listed: dict[str, str] = {}
    for line in table.splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if len(cells) != 3 or "`" not in cells[0]:
            continue
        methods: list[str] = []
        path = ""
        for shown in re.findall(r"`([^`]+)`", cells[0]):
            if shown in ("GET", "POST", "DELETE"):
                methods.append(shown)
                continue
            method, _, rest = shown.rpartition(" ")
            methods = [*methods, method] if method else methods
            path = rest if method else base(path) + rest
            for each in methods if path == "/api/session" else methods[-1:]:
                listed[f"{each} {path}"] = cells[1]
    expected = {
        re.sub(r"\{id\}", name_of(call), call).replace("{index}", "N"): "none" if role == "open" else role
        for call, role in MIN_ROLE.items()
        if not call.startswith("HEAD") and not f"{call.partition(' ')[2]} ".startswith(UNLISTED)
    }
    assert listed == expected


def base(path: str) -> str:
    """Return the address of the resource that a path belongs to."""
    found = re.match(r".*/(SCAN|REC|RUN)", path)
    assert found is not None, path
    return found[0]


def name_of(call: str) -> str:
    """Return how the page names the id in a call."""
    return "REC" if "/recordings/" in call else "RUN" if "/runs/" in call else "SCAN"


def test_each_exception_of_the_client_is_in_the_table() -> None:
    table = (PLANNER / "python-client.md").read_text().split("## Exceptions")[1]
    errors = {name for name in pointchain_client.__all__ if name.endswith("Error")}
    assert errors - set(re.findall(r"`(\w+)`", table)) == set()
