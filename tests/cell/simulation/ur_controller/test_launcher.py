import os
import signal
import socket
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from cell.arm.ur_arm import UrArm
from cell.config.arm_config import SimulatedArm
from cell.kinematics import ur_kinematics
from cell.process.python_process import start_python
from cell.simulation.kinematic_error import KinematicError
from cell.simulation.ur_controller.admin_client import AdminClient, AdminRefusedError, ControllerGoneError
from cell.simulation.ur_controller.launcher import ControllerStartError, RunningController, start_controller
from cell.simulation.ur_controller.servers.sockets import PORTS
from tests.cell.loopback import free_host
from tests.cell.simulation.ur_controller.cell_log import HOME_Q_RAD, wait_for

pytestmark = pytest.mark.xdist_group("cell")  # one at a time, because each test runs several busy processes


def answers(host: str, port: int) -> bool:
    try:
        socket.create_connection((host, port), timeout=1.0).close()
    except (ConnectionRefusedError, ConnectionResetError):  # reset: the controller ended during the connection
        return False
    return True


def test_a_started_controller_accepts_connections_and_close_ends_it():
    q_rad = HOME_Q_RAD + 0.1
    controller = start_controller("ur10e", q_rad=q_rad)
    try:
        assert controller.alive
        assert controller.host.startswith("127.0.0.")
        assert controller.host != "127.0.0.1"  # ur_rtde omits its check of remote control there
        assert all(answers(controller.host, port) for port in PORTS)
        np.testing.assert_array_equal(controller.admin.state().q_rad, q_rad)
    finally:
        controller.close()
    assert not controller.alive
    assert not any(answers(controller.host, port) for port in PORTS)
    with pytest.raises(ProcessLookupError):
        os.kill(controller.pid, 0)  # not even a zombie is left
    with pytest.raises(ControllerGoneError, match=controller.host):
        controller.admin.state()


def test_a_used_address_is_reported_with_an_action(running_controller: RunningController):
    with pytest.raises(ControllerStartError, match=f"{running_controller.host}.*in use.*choose another address"):
        start_controller(host=running_controller.host)


def test_concurrently_started_controllers_have_different_addresses(running_controller: RunningController):
    with ThreadPoolExecutor(2) as pool:
        pair = list(pool.map(lambda _: start_controller(), range(2)))
    for controller in pair:
        controller.close()
    assert len({running_controller.host, *(controller.host for controller in pair)}) == 3


def test_an_address_of_another_machine_is_refused():
    with pytest.raises(ControllerStartError, match=r"192\.0\.2\.1"):
        start_controller(host="192.0.2.1")


def test_the_controller_ends_when_its_parent_is_killed():
    code = (
        "import sys; from cell.simulation.ur_controller.launcher import start_controller\n"
        "controller = start_controller(); print(controller.host, controller.pid, flush=True); sys.stdin.readline()"
    )
    parent = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    try:
        assert parent.stdout is not None
        host, pid = parent.stdout.readline().decode().split()
        os.kill(parent.pid, signal.SIGKILL)
    finally:
        parent.kill()
        parent.communicate()
    wait_for(lambda: not answers(host, PORTS[0]), f"the end of process {pid}")


def test_the_admin_port_refuses_unknown_calls_with_a_message(controller: RunningController):
    with pytest.raises(AdminRefusedError, match="must not be negative"):
        controller.admin.slow(delay_s=-1.0)
    with pytest.raises(AdminRefusedError, match="reshape"):
        controller.admin.reset([0.0, 0.0])
    with socket.create_connection((controller.host, PORTS[0]), timeout=5.0) as connection:
        connection.sendall(b'{"call": "_answer", "arguments": {}}\nnonsense\n')
        lines = connection.makefile()
        assert "there is no call" in lines.readline()
        assert "JSONDecodeError" in lines.readline()


def test_the_pose_can_be_queried_often_and_after_closing(controller: RunningController):
    client = AdminClient(controller.host)
    np.testing.assert_allclose(client.pose(), ur_kinematics.forward("ur5e", HOME_Q_RAD), atol=1e-12)
    for _ in range(100):
        client.pose()
    client.close()
    np.testing.assert_allclose(
        client.pose(), ur_kinematics.forward("ur5e", HOME_Q_RAD), atol=1e-12
    )  # the client connects again
    client.close()


def test_only_the_reported_pose_has_a_smooth_error():
    with start_controller("ur5e", free_host(), q_rad=HOME_Q_RAD, pose_error=(0.0006, 0.0026), seed=5) as controller:
        nominal = ur_kinematics.forward("ur5e", HOME_Q_RAD)
        np.testing.assert_allclose(controller.admin.pose(), nominal, atol=1e-12)
        arm = UrArm(SimulatedArm(), controller.host)
        try:
            arm.connect()
            reported = arm.state().T_base_flange
        finally:
            arm.close()
    expected = KinematicError(0.0006, 0.0026, 5).apply(nominal)
    np.testing.assert_allclose(reported, expected, atol=1e-9)
    assert np.linalg.norm(reported[:3, 3] - nominal[:3, 3]) > 1e-4


def test_the_controller_starts_without_slow_imports() -> None:
    program = "import sys, cell.simulation.ur_controller.controller; print({'pydantic', 'scipy'} & set(sys.modules))"
    with start_python("-c", program, stdout=subprocess.PIPE) as process:
        assert process.communicate()[0] == b"set()\n"
