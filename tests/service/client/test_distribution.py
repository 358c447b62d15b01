"""The client is a distribution of its own: its dependencies, its wheel, and nothing else of the project."""

import ast
import inspect
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

from pointchain_client import AsyncClient, Client

ROOT = Path(__file__).resolve().parents[3]
FOLDER = ROOT / "service" / "client"
PROJECT = tomllib.loads((FOLDER / "pyproject.toml").read_text())
ALLOWED = {"numpy", "httpx2", "pointchain_client"}
"""Packages beside the standard library that the client may import."""

BUILD = "from setuptools import build_meta; print(build_meta.build_wheel('dist'))"
USE_ALONE = """
import sys
from importlib.metadata import requires

OURS = {"service", "cell", "recognition", "calibration", "pydantic", "scipy"}

class Refuse:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in OURS:
            raise ImportError(f"{name} must not be imported")

sys.meta_path.insert(0, Refuse())
sys.path.insert(0, sys.argv[1])
import pointchain_client
assert pointchain_client.__file__.startswith(sys.argv[1]), pointchain_client.__file__
print(sorted(line.partition("<")[0] for line in requires("pointchain-client")))
"""


def test_only_numpy_and_httpx2_are_imported() -> None:
    imported: set[str] = set()
    for file in (FOLDER / "pointchain_client").rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Import):
                imported |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                imported.add((node.module or "").partition(".")[0])
    assert imported - set(sys.stdlib_module_names) == ALLOWED


def test_both_clients_have_the_same_methods_and_arguments() -> None:
    methods = {name: kind for name, kind in vars(Client).items() if inspect.isfunction(kind) and name[0] != "_"}
    coroutines = {name: kind for name, kind in vars(AsyncClient).items() if inspect.isfunction(kind) and name[0] != "_"}
    assert set(methods) == set(coroutines)
    for name, method in methods.items():
        assert inspect.signature(coroutines[name]).parameters == inspect.signature(method).parameters, name
    assert inspect.signature(Client).parameters == inspect.signature(AsyncClient).parameters


def test_each_package_of_the_folder_is_installed() -> None:
    packages = {".".join(file.parent.relative_to(FOLDER).parts) for file in FOLDER.rglob("__init__.py")}
    assert set(PROJECT["tool"]["setuptools"]["packages"]) == packages - {name for name in packages if "build" in name}


def test_each_dependency_has_a_comment_with_its_use() -> None:
    lines = re.findall(r'^    "[^"]*".*$', (FOLDER / "pyproject.toml").read_text(), flags=re.MULTILINE)
    assert len(lines) == len(PROJECT["project"]["dependencies"]) == 2
    assert [line for line in lines if not re.search(r'",\s*# \S', line)] == []


def test_it_has_the_version_and_the_licence_of_the_project() -> None:
    main = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert PROJECT["project"]["version"] == main["version"]
    assert PROJECT["project"]["license"] == main["license"]
    assert (FOLDER / "LICENSE").read_text() == (ROOT / "LICENSE").read_text()


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel of the client."""
    source = tmp_path_factory.mktemp("client") / "source"
    shutil.copytree(FOLDER, source, ignore=shutil.ignore_patterns("build", "*.egg-info", "__pycache__"))
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", BUILD], cwd=source, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return source / "dist" / done.stdout.splitlines()[-1]


def test_the_wheel_has_only_the_client(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    files = {name for name in names if ".dist-info/" not in name}
    modules = (FOLDER / "pointchain_client").rglob("*.py")
    assert files == {file.relative_to(FOLDER).as_posix() for file in modules} | {"pointchain_client/py.typed"}
    assert any(name.endswith("licenses/LICENSE") for name in names)


def test_pip_install_gives_a_client_that_needs_nothing_else_of_the_project(wheel: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path / "installed")
    # -P and -E leave only the unpacked wheel and the installed packages
    command = [sys.executable, "-P", "-E", "-c", USE_ALONE, str(tmp_path / "installed")]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "['httpx2', 'numpy']"
