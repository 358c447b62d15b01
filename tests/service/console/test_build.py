"""The packages, the size and the files of the built console."""

import json
import re
import tomllib
from pathlib import Path

import service
from service.api.routes.console import BUILT

WEB = BUILT.parent / "web"
ROOT = Path(service.__file__).parents[1]

SCREEN_BYTES = 150_000
"""Size limit of the files that the page loads to show a screen. The 3D view is excluded."""
VIEW3D_BYTES = 700_000


def test_the_lock_names_no_registry_and_has_a_hash_for_each_package() -> None:
    lock = (WEB / "package-lock.json").read_text()
    assert '"resolved"' not in lock
    packages = json.loads(lock)["packages"]
    assert all("integrity" in package for path, package in packages.items() if path)


def test_each_package_has_an_exact_version_and_a_reason() -> None:
    package = json.loads((WEB / "package.json").read_text())
    versions = package["dependencies"] | package["devDependencies"]
    assert all(re.fullmatch(r"\d+\.\d+\.\d+", version) for version in versions.values())
    assert set(package["//"]) == set(versions)


def imported_with(name: str) -> set[str]:
    """Return the built scripts that a script loads before it runs, itself included."""
    found: set[str] = set()
    pending = [name]
    while pending:
        script = pending.pop()
        if script not in found:
            found.add(script)
            pending += re.findall(r'(?:from|import)\s*"\./([^"]+)"', (BUILT / script).read_text())
    return found


def test_each_screen_is_small_and_the_3d_view_is_loaded_on_demand() -> None:
    (view3d,) = [path.name for path in BUILT.glob("view3d-*.js")]
    assert (BUILT / view3d).stat().st_size < VIEW3D_BYTES
    page = {"index.html", "main.css"} | imported_with("stop.js") | imported_with("main.js")
    for screen in ("scan", "result", "history", "calibration"):
        (script,) = [path.name for path in BUILT.glob(f"{screen}-*.js")]
        assert script not in page
        files = page | imported_with(script)
        assert view3d not in files
        assert "WebGLRenderer" not in "".join((BUILT / name).read_text() for name in files)
        assert sum((BUILT / name).stat().st_size for name in files) < SCREEN_BYTES, screen


def test_the_3d_view_sends_no_requests() -> None:
    """Code of the 3D view can therefore not move the robot."""
    for path in (WEB / "src/view3d").glob("*.ts"):
        source = path.read_text()
        assert not re.search(r"fetch\(|XMLHttpRequest|WebSocket|EventSource|sendBeacon|\.\./(net|state)/", source), (
            path.name
        )


def test_built_files_are_part_of_the_wheel() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    assert project["package-data"]["service.console"] == ["built/*"]
    assert "service.console" in project["packages"]
    assert not [path for path in BUILT.iterdir() if path.is_dir()]
