"""The controller of `--host`, ready for moves. Without `--host`, the virtual controller."""

import time
from collections.abc import Iterator

import pytest
from universal_robots_clients import dashboard_client

from cell.arm.ur_arm import UrArm
from cell.config.arm_config import ArmSettings
from cell.simulation.ur_controller.launcher import RunningController
from tests.cell.arm.virtual_arm import fresh
from tests.cell.conformance.witness import Witness

READY_S = 60.0
"""Timeout of switching on, seconds. A robot needs about half a minute."""


@pytest.fixture
def host(request: pytest.FixtureRequest) -> str:
    """Return the address of the controller: switched on, brakes released, without a program."""
    address = request.config.getoption("host")
    if address is None:
        controller: RunningController = request.getfixturevalue("controller")
        fresh(controller)
        address = controller.host
    remote = dashboard_client.send_command(address, "is in remote control", timeout=10.0)
    assert remote == "true", "the robot is in local control: switch it to remote control at its pendant"
    switch_on(address)
    dashboard_client.send_command(address, "stop", timeout=10.0)
    return address


@pytest.fixture
def settings(request: pytest.FixtureRequest) -> ArmSettings:
    """Return the settings of a slow arm, because the arm may be real."""
    options = {"model": request.config.getoption("model"), "speed_rad_s": 0.5, "flange_speed_m_s": 0.4}
    return ArmSettings.model_validate(options)


@pytest.fixture
def arm(host: str, settings: ArmSettings) -> Iterator[UrArm]:
    """Yield a connected arm."""
    arm = UrArm(settings, host)
    arm.connect()
    yield arm
    arm.close()


@pytest.fixture
def witness(host: str) -> Iterator[Witness]:
    """Yield a client that records the data of the controller."""
    with Witness(host) as witness:
        yield witness


def switch_on(host: str) -> None:
    """Switch the power on and release the brakes, as a person does at the pendant."""
    limit_s = time.monotonic() + READY_S
    while (mode := dashboard_client.send_command(host, "robotmode", timeout=10.0)) != "Robotmode: RUNNING":
        assert time.monotonic() < limit_s, f"the robot does not become ready: {mode}"
        dashboard_client.send_command(host, "brake release" if "IDLE" in mode else "power on", timeout=10.0)
        time.sleep(0.5)
