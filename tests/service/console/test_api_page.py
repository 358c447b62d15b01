"""The page of the API at /docs in a browser: it shows the recorded examples."""

import json

import pytest
from playwright.sync_api import expect

from service.api.examples import read_examples
from tests.service.conftest import ServedClient
from tests.service.console.conftest import Open

pytestmark = pytest.mark.xdist_group("console")  # one at a time: each test runs several busy processes


def test_a_call_shows_its_examples(open_console: Open, client: ServedClient) -> None:
    examples = read_examples()["start_scan"]
    page = open_console(client, "docs").page
    call = page.locator("[id$='-start_scan']")
    call.locator("button.opblock-summary-control").click()
    select = call.locator(".opblock-section-request-body .examples-select-element")
    expect(select.locator("option")).to_have_text([example["summary"] for example in examples["request"].values()])
    for example in examples["request"].values():
        select.select_option(label=example["summary"])
        body = call.locator("textarea.body-param__text")
        expect(body).to_have_value(json.dumps(example["value"], indent=2))
    (answer,) = examples["responses"]["202"].values()
    expect(call.locator("tr.response[data-code='202'] pre.example")).to_contain_text(answer["value"]["id"])
