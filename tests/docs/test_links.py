"""Links in the documents lead to an existing file, picture or heading."""

from pathlib import Path
from urllib.parse import unquote

import pytest

from tests.docs.pages import DOCS, ROOT, anchors, links, name_of, pages

PICTURE_BYTES = 300_000


def broken(page: Path) -> list[str]:
    """Return an error message for each broken link of a page."""
    wrong = []
    for line, target in links(page):
        where = f"{name_of(page)}:{line}: {target}"
        if target.startswith(("http://127.0.0.1", "mailto:")):
            continue
        if "://" in target:
            # Tests do not contact other sites. Only https is allowed.
            if not target.startswith("https://"):
                wrong.append(f"{where}: not https")
            continue
        path, _, anchor = unquote(target).partition("#")
        file = (page.parent / path).resolve() if path else page
        if not file.exists():
            wrong.append(f"{where}: there is no such file")
        elif not file.is_relative_to(ROOT):
            wrong.append(f"{where}: outside the project")
        elif anchor and (file.suffix != ".md" or anchor not in anchors(file)):
            wrong.append(f"{where}: there is no such heading")
    return wrong


@pytest.mark.parametrize("page", pages(), ids=name_of)
def test_links_resolve(page: Path) -> None:
    assert broken(page) == []


def test_wrong_links_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = tmp_path / "page.md"
    page.write_text(
        "# Title\n\n[a](no.md) [b](#title) [c](#no) [d](http://example.com) [e](https://example.com) ![f](no.png)\n"
    )
    monkeypatch.setattr("tests.docs.test_links.ROOT", tmp_path)
    monkeypatch.setattr("tests.docs.test_links.name_of", lambda _: "page.md")
    assert [line.split(": ", 1)[1] for line in broken(page)] == [
        "no.md: there is no such file",
        "#no: there is no such heading",
        "http://example.com: not https",
        "no.png: there is no such file",
    ]


def test_each_page_is_linked() -> None:
    linked = {(page.parent / target.partition("#")[0]).resolve() for page in pages() for _, target in links(page)}
    orphans = [name_of(page) for page in pages() if page.is_relative_to(DOCS) and page not in linked]
    assert orphans == []


def test_pictures_are_small_and_used() -> None:
    linked = {(page.parent / target.partition("#")[0]).resolve() for page in pages() for _, target in links(page)}
    for picture in (DOCS / "images").iterdir():
        assert picture.stat().st_size <= PICTURE_BYTES, picture.name
        assert picture in linked, f"no page shows {picture.name}"
