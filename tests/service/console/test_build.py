"""The packages, the size and the files of the built console."""

import json
import re
import tomllib
from pathlib import Path

import service
from service.api.routes.console import BUILT

WEB = BUILT.parent / "web"
ROOT = Path(service.__file__).parents[1]

SHELL_BYTES = 150_000
"""Size limit of the files that the page loads before it shows anything. The 3D view is excluded."""
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


def test_the_page_is_small_and_loads_the_3d_view_on_demand() -> None:
    scripts = {path.name: path.read_text() for path in BUILT.glob("*.js")}
    (view3d,) = [name for name in scripts if name.startswith("view3d-")]
    assert len(scripts.pop(view3d)) < VIEW3D_BYTES
    assert "WebGLRenderer" not in "".join(scripts.values())
    assert not any(re.search(rf'(from|import)\s*"\./{re.escape(view3d)}"', script) for script in scripts.values())
    others = [
        path.stat().st_size for path in BUILT.iterdir() if path.name in scripts or path.suffix in (".css", ".html")
    ]
    assert sum(others) < SHELL_BYTES


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
