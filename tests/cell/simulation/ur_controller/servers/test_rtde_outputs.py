"""Rates, time stamps and versions of RTDE outputs, as UR's own clients expect them."""

import itertools
import os
import signal
import time
from collections.abc import Iterator

import numpy as np
import pytest

from cell.simulation.ur_controller.launcher import RunningController, start_controller
from tests.cell.simulation.ur_controller.rtde_client import RtdeClient

pytestmark = pytest.mark.xdist_group("cell")  # one at a time, because each test runs several busy processes

CYCLE_S = 0.002
IN_ALL_VERSIONS = {
    "actual_configurable_digital_output_bits": "UINT64",
    "encoder0_raw": "INT32",
    "encoder1_raw": "INT32",
    "euromap67_24V_voltage": "DOUBLE",
    "euromap67_24V_current": "DOUBLE",
    "wrench_calc_from_currents": "VECTOR6D",
}
SINCE_5_23 = {
    "actual_current_as_torque": "VECTOR6D",
    "actual_robot_energy_consumed": "DOUBLE",
    "actual_robot_braking_energy_dissipated": "DOUBLE",
}
SINCE_5_26 = {
    "target_gravity": "VECTOR3D",
    "target_base_acceleration": "VECTOR6D",
    "target_base_wrench": "VECTOR6D",
    "control_step": "UINT64",
}


@pytest.fixture(scope="module")
def newest_controller() -> Iterator[RunningController]:
    with start_controller(software="5.26.0") as running:
        yield running


def stamps_s(host: str, hz: float, count: int) -> np.ndarray:
    with RtdeClient(host) as client:
        client.outputs(["timestamp"], hz)
        client.start()
        return np.array([client.data()["timestamp"] for _ in range(count)])


def cycles(stamps: np.ndarray) -> np.ndarray:
    """Return the gaps between time stamps in control cycles, which must be whole numbers."""
    gaps = np.diff(stamps) / CYCLE_S
    np.testing.assert_allclose(gaps, np.round(gaps), atol=1e-6)
    return np.round(gaps).astype(int)


@pytest.mark.parametrize(("hz", "expected"), [(500.0, 1), (125.0, 4), (25.0, 20), (300.0, 2), (333.0, 2), (60.0, 9)])
def test_time_stamps_advance_by_whole_control_cycles(controller: RunningController, hz: float, expected: int):
    gaps = cycles(stamps_s(controller.host, hz, max(12, int(hz / 3))))
    assert gaps.min() == expected
    assert np.mean(gaps == expected) >= 0.9  # a busy machine omits some packages


def test_the_first_two_packages_at_25_hz_are_one_period_apart(controller: RunningController):
    assert np.median([np.diff(stamps_s(controller.host, 25.0, 2)) for _ in range(5)]) == pytest.approx(0.04, abs=1e-6)


def test_a_controller_that_was_held_up_catches_up_with_the_clock(controller: RunningController):
    with RtdeClient(controller.host) as client:
        client.outputs(["timestamp"])
        client.start()
        first_s, began_s = client.data()["timestamp"], time.monotonic()
        os.kill(controller.pid, signal.SIGSTOP)
        time.sleep(0.3)
        os.kill(controller.pid, signal.SIGCONT)
        stamps = [first_s]
        while stamps[-1] - first_s < 0.4:
            stamps.append(client.data()["timestamp"])
        elapsed_s = time.monotonic() - began_s
    gaps = cycles(np.array(stamps))
    assert gaps.min() >= 1
    assert gaps.max() > 100  # the packages of the missing time are omitted, not sent late
    assert elapsed_s >= stamps[-1] - first_s - 0.05


def test_a_rate_below_1_hz_is_refused_and_the_text_says_so(controller: RunningController):
    with RtdeClient(controller.host) as client:
        assert client.outputs(["timestamp"], 0.5) == (0, [""])
        assert not client.start()
        assert "1 to 500 Hz are possible" in client.messages[0]
        assert client.outputs(["timestamp"], 1.0)[0] == 1


def test_outputs_exist_from_the_version_that_introduced_them(
    fast_controller: RunningController, controller: RunningController, newest_controller: RunningController
):
    for running, known in (
        (fast_controller, IN_ALL_VERSIONS),
        (controller, IN_ALL_VERSIONS | SINCE_5_23),
        (newest_controller, IN_ALL_VERSIONS | SINCE_5_23 | SINCE_5_26),
    ):
        names = list(IN_ALL_VERSIONS | SINCE_5_23 | SINCE_5_26)
        with RtdeClient(running.host) as client:
            assert client.outputs(names)[1] == [known.get(name, "NOT_FOUND") for name in names]


def test_the_added_outputs_have_values_of_the_simulation(newest_controller: RunningController):
    with RtdeClient(newest_controller.host) as client:
        recipe, _ = client.inputs(["configurable_digital_output_mask", "configurable_digital_output"])
        client.write(recipe, "BB", 0b101, 0b111)
        client.outputs(["timestamp", *IN_ALL_VERSIONS, *SINCE_5_23, *SINCE_5_26])
        client.start()
        packages = [client.data() for _ in range(20)]
    assert packages[-1]["actual_configurable_digital_output_bits"] == 0b101
    assert packages[-1]["target_gravity"] == [0.0, 0.0, 9.82]
    for package in packages:
        assert package["control_step"] * CYCLE_S == pytest.approx(package["timestamp"], abs=1e-9)
    assert all(later["control_step"] > earlier["control_step"] for earlier, later in itertools.pairwise(packages))
