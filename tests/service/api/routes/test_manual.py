"""The manual at /manual: its routes and headers, and the links of the pages that are built."""

import base64
import hashlib
import re
import tomllib
from collections.abc import Callable
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import httpx2
import pytest

import service
from service.api.routes import manual
from service.problems.problem_types import PROBLEM_TYPES
from service.security.middleware.headers import DOCS_POLICY, MANUAL_FOLDER, SCRIPT_HASHES, manual_policy
from tests.service.conftest import ServedClient

ROOT = Path(service.__file__).parents[1]

AssertProblem = Callable[[httpx2.Response, int, str], str]


@pytest.fixture
def pages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a small manual in place of the built one. A file beside its folder must not be served."""
    folder = tmp_path / "manual"
    (folder / "operator").mkdir(parents=True)
    (folder / "index.html").write_text("<title>Start</title>")
    (folder / "operator/index.html").write_text("<title>Operator</title>")
    (folder / "style.css").write_text("a{}")
    (tmp_path / "secret.html").write_text("secret")
    (folder / "link.html").symlink_to(tmp_path / "secret.html")
    monkeypatch.setattr(manual.FILES, "directory", folder)
    monkeypatch.setattr(manual.FILES, "all_directories", [folder])
    return folder


@pytest.mark.usefixtures("pages")
@pytest.mark.parametrize(
    ("path", "kind", "text"),
    [
        ("/manual/", "text/html", "Start"),
        ("/manual/index.html", "text/html", "Start"),
        ("/manual/operator/", "text/html", "Operator"),
        ("/manual/style.css?v=1", "text/css", "a{}"),
    ],
)
def test_files_have_their_type_and_are_checked_again(client: ServedClient, path: str, kind: str, text: str) -> None:
    answer = client.get(path)
    assert answer.status_code == 200
    assert text in answer.text
    assert answer.headers["content-type"].startswith(kind)
    assert answer.headers["cache-control"] == "no-cache"
    assert client.get(path, headers={"If-None-Match": answer.headers["etag"]}).status_code == 304
    head = client.head(path)
    assert (head.status_code, head.content) == (200, b"")
    assert head.headers["etag"] == answer.headers["etag"]
    assert int(head.headers["content-length"]) == len(answer.content)


@pytest.mark.usefixtures("pages")
def test_the_address_without_a_slash_is_redirected(client: ServedClient) -> None:
    for method in ("GET", "HEAD"):
        answer = client.request(method, "/manual")
        assert (answer.status_code, answer.headers["location"]) == (307, "/manual/")


@pytest.mark.usefixtures("pages")
@pytest.mark.problem("method-not-allowed")
def test_the_manual_can_only_be_read(client: ServedClient, assert_problem: AssertProblem) -> None:
    for path in ("/manual", "/manual/", "/manual/index.html"):
        answer = client.post(path, headers={"X-Pointchain": "test"})
        assert_problem(answer, 405, "method-not-allowed")
        assert answer.headers["allow"] == "GET, HEAD"


@pytest.mark.usefixtures("pages")
@pytest.mark.parametrize(
    "path",
    [
        "/manual/none.html",
        "/manual/link.html",
        "/manual/%2e%2e/secret.html",
        "/manual/..%2fsecret.html",
        "/manual/operator/%2e%2e/%2e%2e/secret.html",
        "/manual/operator/%2e%2e",
        "/manual//etc/passwd",
        "/manual/%00",
        "/manual/" + "a" * 1000,
    ],
)
def test_no_other_file_is_served(client: ServedClient, assert_problem: AssertProblem, path: str) -> None:
    # The raw target, since a client library resolves `..` itself.
    url = httpx2.URL(client.base_url, raw_path=path.encode())
    answer = client.get(url)
    assert answer.status_code == 404
    assert answer.json()["type"] == "urn:pointchain:not-found"
    assert "secret" not in answer.json()["detail"]


@pytest.mark.problem("manual-not-built")
def test_the_service_works_without_a_built_manual(
    client: ServedClient, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, assert_problem: AssertProblem
) -> None:
    monkeypatch.setattr(manual.FILES, "all_directories", [tmp_path / "none"])
    for path in ("/manual/", "/manual/operator/index.html"):
        assert "make setup" in assert_problem(client.get(path), 503, "manual-not-built")
    assert client.get("/healthz").status_code == 200
    assert "script-src 'self'" in manual_policy(tmp_path / "none")


def test_only_hashes_get_into_the_policy(tmp_path: Path) -> None:
    good = "sha256-" + "A" * 43 + "="
    (tmp_path / "hashes.txt").write_text(f"{good}\n'unsafe-inline'\nsha256-short=\n{good}; x\n")
    assert manual_policy(tmp_path / "hashes.txt") == f"{DOCS_POLICY}; script-src 'self' '{good}'"


def test_only_the_manual_has_its_policy(client: ServedClient) -> None:
    policy = client.get("/manual/").headers["content-security-policy"]
    assert policy == manual_policy()
    assert "style-src 'self' 'unsafe-inline'" in policy
    assert "img-src 'self' data:" in policy
    assert "unsafe" not in policy[policy.index("script-src") :]
    for path in ("/", "/docs", "/healthz", "/manuals", "/manual"):
        assert "script-src" not in client.get(path).headers["content-security-policy"]


def test_the_description_of_the_api_does_not_list_the_manual() -> None:
    assert "/manual" not in (ROOT / "service/openapi.json").read_text()


def test_the_manual_goes_into_a_wheel() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    assert "manual/**/*" in project["tool"]["setuptools"]["package-data"]["service"]
    assert project["project"]["license-files"] == ["LICENSE"]
    assert (ROOT / "LICENSE").is_file()


class Page(HTMLParser):
    """The anchors and links of a page, and the scripts inside it."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.ids: set[str] = set()
        self.links: set[str] = set()
        self.scripts: list[str] = []
        self._inside = False
        self.feed(path.read_text())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Collect anchors and links."""
        given = dict(attrs)
        if (anchor := given.get("id")) is not None:
            self.ids.add(anchor)
        self.links |= {link for name in ("href", "src") if (link := given.get(name))}
        self._inside = tag == "script" and "src" not in given

    def handle_data(self, data: str) -> None:
        """Collect scripts."""
        if self._inside:
            self.scripts.append(data)

    def handle_endtag(self, tag: str) -> None:
        """End a script."""
        if tag == "script":
            self._inside = False


@cache
def built(path: Path) -> Page:
    return Page(path)


def built_pages() -> list[Path]:
    found = sorted(MANUAL_FOLDER.rglob("*.html"))
    assert MANUAL_FOLDER / "index.html" in found, "the manual is not built: run `make setup`"
    return found


def broken(page: Path, link: str) -> bool:
    """Return whether a relative link of a page leads to no file or no anchor of the manual."""
    parts = urlsplit(link)
    if parts.scheme or parts.netloc:
        return False
    target = (page.parent / unquote(parts.path)).resolve() if parts.path else page
    if target.is_dir():
        target /= "index.html"
    if not target.is_relative_to(MANUAL_FOLDER) or not target.is_file():
        return True
    return bool(parts.fragment) and target.suffix == ".html" and unquote(parts.fragment) not in built(target).ids


def test_every_link_within_the_manual_has_a_target() -> None:
    found = [
        f"{page.relative_to(MANUAL_FOLDER)}: {link}"
        for page in built_pages()
        for link in sorted(built(page).links)
        if broken(page, link)
    ]
    assert found == []


def test_no_page_loads_anything_from_another_host() -> None:
    for page in built_pages():
        loaded = re.findall(
            r"<(?:script|img|iframe|link)\b[^>]*\b(?:src|href)=\"(?:https?:)?//[^\"]*", page.read_text()
        )
        assert loaded == [], page.name


def test_every_script_inside_a_page_is_allowed_by_its_hash() -> None:
    allowed = set(SCRIPT_HASHES.read_text().split())
    scripts = {script for page in built_pages() for script in built(page).scripts}
    assert scripts
    for script in scripts:
        digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
        assert f"sha256-{digest}" in allowed, script


def test_the_licences_of_the_included_software_are_included() -> None:
    text = (MANUAL_FOLDER / "licences.txt").read_text()
    for name in ("sphinx", "furo", "sphinx-copybutton", "STIX Two Math"):
        assert f"{name}\n\n" in text
    assert text.count("Copyright") >= 4


def test_every_type_of_problem_has_its_row_and_its_section() -> None:
    """The console links to the rows."""
    rows = built(MANUAL_FOLDER / "planner/errors.html").ids
    sections = set().union(*(built(page).ids for page in (MANUAL_FOLDER / "planner/errors").glob("*.html")))
    assert set(PROBLEM_TYPES) - (rows & sections) == set()


def test_every_section_that_the_console_links_to_exists() -> None:
    source = (ROOT / "service/console/web/src/ui/manual.tsx").read_text()
    sections = re.findall(r'"([a-z/-]+\.html)#([a-z-]+)"', source)
    assert len(sections) == 5
    for page, anchor in sections:
        assert anchor in built(MANUAL_FOLDER / page).ids, f"{page}#{anchor}"


def test_every_fault_that_the_console_links_to_has_its_type_and_section() -> None:
    source = (ROOT / "service/console/web/src/ui/manual.tsx").read_text()
    table = source[source.index("FAULTS") :]
    faults = re.findall(r'^  "([a-z-]+)": "([a-z-]+)",$', table[: table.index("};")], re.MULTILINE)
    assert len(faults) == 28
    assert {slug for slug, _ in faults} <= set(PROBLEM_TYPES)
    assert {section for _, section in faults} <= built(MANUAL_FOLDER / "operator/faults.html").ids
