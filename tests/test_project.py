"""The project files: installed packages, imports at start-up, dependencies, the lock file and licences."""

import importlib
import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[1]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
CLIENT = ROOT / "service" / "client"
"""Folder of the planners' client, a distribution of its own."""
CLIENT_PROJECT = tomllib.loads((CLIENT / "pyproject.toml").read_text())
LOCK = (ROOT / "requirements.lock").read_text()

# The supported platforms, as the environment markers of pip distinguish them.
PLATFORMS = {
    "Linux x86-64": {"sys_platform": "linux", "platform_system": "Linux", "platform_machine": "x86_64"},
    "Linux ARM": {"sys_platform": "linux", "platform_system": "Linux", "platform_machine": "aarch64"},
    "macOS ARM": {"sys_platform": "darwin", "platform_system": "Darwin", "platform_machine": "arm64"},
}
PYTHONS = {"3.11": "3.11.2", "3.12": "3.12.3"}

FIND_PACKAGES = """
import importlib.util, json
places = {}
for name in ["service", "cell", "calibration", "recognition", "docker", "tests", "pointchain_client"]:
    spec = importlib.util.find_spec(name)
    places[name] = list(spec.submodule_search_locations or [spec.origin]) if spec else []
print(json.dumps(places))
"""
SHOW_HELP = """
import json, sys
from service.cli.main import main
try:
    status = main(["--help"])
except SystemExit as stop:
    status = stop.code
print()
print(json.dumps([status, sorted({name.partition(".")[0] for name in sys.modules})]))
"""


def run_python(code: str, cwd: Path) -> str:
    """Run `code` in a new interpreter without the project's folder on its path, and return its output."""
    # -P keeps the working directory off sys.path and -E ignores PYTHONPATH, so only the installation counts.
    result = subprocess.run(
        [sys.executable, "-P", "-E", "-c", code], cwd=cwd, capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stderr
    return result.stdout


@pytest.mark.parametrize("name", ["service", "cell", "calibration", "recognition"])
def test_the_package_comes_from_this_repository(name: str) -> None:
    file = importlib.import_module(name).__file__
    assert file is not None
    assert Path(file).resolve() == ROOT / name / "__init__.py"


def test_only_the_four_packages_and_the_client_are_installed(tmp_path: Path) -> None:
    places = json.loads(run_python(FIND_PACKAGES, cwd=tmp_path))
    client = [Path(place).resolve() for place in places.pop("pointchain_client")]
    assert client == [CLIENT / "pointchain_client"], "the installation differs from `make setup`"
    ours = {name for name, found in places.items() if any(Path(p).resolve().is_relative_to(ROOT / name) for p in found)}
    assert ours == {"service", "cell", "calibration", "recognition"}, "the installation differs from `make setup`"


NOT_INSTALLED = {"cell.simulation.benchmark", "cell.simulation.grasp_physics", "service.benchmark"}
"""Packages that are not installed: they exist in a checkout only."""


def test_every_package_folder_except_the_benchmarks_is_installed() -> None:
    # The list in pyproject.toml is written by hand, so a new folder is easily forgotten.
    folders = {
        ".".join(file.parent.relative_to(ROOT).parts)
        for top in ("service", "cell", "calibration", "recognition")
        for file in (ROOT / top).rglob("__init__.py")
        if not file.is_relative_to(CLIENT)
    }
    assert folders >= NOT_INSTALLED
    assert sorted(PYPROJECT["tool"]["setuptools"]["packages"]) == sorted(folders - NOT_INSTALLED)


def test_the_examples_of_the_api_are_installed() -> None:
    assert PYPROJECT["tool"]["setuptools"]["package-data"]["service.api"] == ["examples.json"]


def test_help_imports_no_heavy_library(tmp_path: Path) -> None:
    output = run_python(SHOW_HELP, cwd=tmp_path)
    status, modules = json.loads(output.splitlines()[-1])
    assert status in (0, None)
    assert "recognise" in output
    heavy = {"open3d", "mujoco", "depthai", "scipy", "matplotlib", "fastapi", "mcap"}
    assert not heavy & set(modules)
    assert not [name for name in modules if name.startswith("rtde_")]


def test_every_dependency_has_a_comment_with_its_use() -> None:
    text = (ROOT / "pyproject.toml").read_text()
    project = text[text.index("[project]") : text.index("[project.scripts]")]
    lines = re.findall(r'^    "[^"]*".*$', project, flags=re.MULTILINE)
    extras = PYPROJECT["project"]["optional-dependencies"].values()
    assert len(lines) == len(PYPROJECT["project"]["dependencies"]) + sum(map(len, extras))
    assert [line for line in lines if not re.search(r'",\s*# \S', line)] == []


def locked_requirements() -> list[tuple[Requirement, list[str]]]:
    """Return the requirements of the lock file, each with its hashes."""
    joined = LOCK.replace("\\\n", " ")
    result = []
    for line in joined.splitlines():
        if line.strip() and not line.lstrip().startswith("#"):
            requirement, *hashes = re.split(r"\s+--hash=", line.strip())
            result.append((Requirement(requirement), hashes))
    return result


def test_every_locked_package_has_one_version_and_hashes() -> None:
    for requirement, hashes in locked_requirements():
        assert [part.operator for part in requirement.specifier] == ["=="], str(requirement)
        assert hashes, str(requirement)
        assert all(re.fullmatch(r"sha256:[0-9a-f]{64}", value) for value in hashes), str(requirement)


def test_the_lock_contains_no_index_and_no_local_path() -> None:
    assert "://" not in LOCK
    # Only hashes and comments may follow a requirement: no --index-url, -f, -e or @ file.
    for line in LOCK.splitlines():
        assert re.fullmatch(r"\s*#.*|[\w.-]+==\S+( ; [^@/]*)? \\|    --hash=sha256:\w+( \\)?", line), line
    # Comments contain package names, pyproject.toml and the command that made the file, but no path or option.
    assert not re.search(r"#.*(\s/|\s~|--|[A-Za-z]:\\)", LOCK)


@pytest.mark.parametrize("python", PYTHONS)
@pytest.mark.parametrize("platform", PLATFORMS)
def test_the_lock_satisfies_the_direct_dependencies(python: str, platform: str) -> None:
    project = PYPROJECT["project"]
    # Setuptools builds the editable install and is taken from the lock too.
    required = [*PYPROJECT["build-system"]["requires"], *project["dependencies"]]
    required += CLIENT_PROJECT["project"]["dependencies"]
    for extra in project["optional-dependencies"].values():
        required += extra
    environment = {
        "python_version": python,
        "python_full_version": PYTHONS[python],
        "implementation_name": "cpython",
        "platform_python_implementation": "CPython",
        "os_name": "posix",
        **PLATFORMS[platform],
    }
    versions = {
        canonicalize_name(requirement.name): next(iter(requirement.specifier)).version
        for requirement, _ in locked_requirements()
        if requirement.marker is None or requirement.marker.evaluate(environment)
    }
    for line in required:
        requirement = Requirement(line)
        if requirement.marker is None or requirement.marker.evaluate(environment):
            version = versions.get(canonicalize_name(requirement.name))
            assert version is not None, f"{line} is not in the lock: make lock"
            assert requirement.specifier.contains(version), f"{line}, but {version} is locked: make lock"


def test_every_package_is_listed_with_a_licence_for_commercial_use() -> None:
    result = subprocess.run([sys.executable, str(ROOT / ".ci/licences")], capture_output=True, text=True, check=True)
    listing = result.stdout
    # With another Python, some packages have another version and another name for their licence.
    if "{}.{}".format(*sys.version_info) == (ROOT / ".python-version").read_text().strip():
        assert (ROOT / "LICENCES.md").read_text() == listing, "make licences"
    licences = dict(re.findall(r"^\| ([^|]+) \| ([^|]+) \|$", listing, flags=re.MULTILINE))
    dependencies = [*PYPROJECT["project"]["dependencies"], *CLIENT_PROJECT["project"]["dependencies"]]
    direct = {canonicalize_name(Requirement(line).name) for line in dependencies}
    assert {"numpy", "ik-geo", "distributed", "rosbags", "pytest"} <= set(licences)
    assert len(direct & set(licences)) >= len(direct) - 1, "only open3d may be listed by another name"
    assert "unknown" not in licences.values()
    # Copyleft and non-commercial licences are not permitted in the product. Development tools may be GPL.
    forbidden = re.compile(r"(?<!L)GPL|SSPL|BUSL|commons clause|non-?commercial|CC-BY-NC", re.IGNORECASE)
    shipped = listing[: listing.index("## For development")]
    assert forbidden.findall(shipped) == []
