"""The unmodified ur_rtde with the virtual controller: connecting, queries, and other clients."""

import numpy as np
import pytest

from cell.kinematics import ur_kinematics
from cell.simulation.ur_controller.launcher import RunningController
from cell.simulation.ur_controller.robot.poses import pose_matrix
from tests.cell.simulation.ur_controller import wheel
from tests.cell.simulation.ur_controller.cell_log import HOME_Q_RAD, LogSince
from tests.cell.simulation.ur_controller.wheel import CONNECT

pytestmark = pytest.mark.xdist_group("cell")  # one at a time, because each test runs several busy processes


def test_ur_rtde_connects_and_reads_the_state(controller: RunningController):
    log = LogSince(controller.admin)
    seen = wheel.run(
        controller.host,
        CONNECT
        + """
first = receive.getTimestamp()
while receive.getTimestamp() - first <= 0.05: time.sleep(0.002)
answer(q=receive.getActualQ(), pose=receive.getActualTCPPose(), robot=receive.getRobotMode(),
       safety=receive.getSafetyMode(), bits=receive.getSafetyStatusBits(), status=receive.getRobotStatus(),
       running=control.isProgramRunning(), runtime=receive.getRuntimeState(), passed=receive.getTimestamp() - first,
       speed=[receive.getSpeedScaling(), receive.getTargetSpeedFraction()],
       steady=control.isSteady())
""",
    )
    np.testing.assert_array_equal(seen["q"], HOME_Q_RAD)
    np.testing.assert_allclose(seen["pose"][:3], ur_kinematics.forward("ur5e", HOME_Q_RAD)[:3, 3], atol=1e-12)
    assert (seen["robot"], seen["safety"], seen["bits"], seen["status"]) == (7, 1, 1, 3)
    assert seen["running"]
    assert seen["runtime"] == 2
    assert seen["speed"] == [1.0, 1.0]
    assert seen["steady"]
    assert seen["passed"] > 0.05
    (upload,) = log.events("script_upload")
    assert upload["details"]["name"] == "rtde_control"


def test_ur_rtde_connects_to_another_arm_with_older_software(fast_controller: RunningController):
    seen = wheel.run(fast_controller.host, CONNECT + "answer(moved=control.moveJ([0.1] * 6, 1.0, 1.0))")
    assert seen["moved"]
    state = fast_controller.admin.state()
    np.testing.assert_array_equal(state.q_rad, [0.1] * 6)
    np.testing.assert_allclose(state.T_base_flange, ur_kinematics.forward("ur3e", [0.1] * 6), atol=1e-12)


def test_the_kinematics_and_limits_are_answered(controller: RunningController):
    controller.admin.table(0.05)
    tool = [0.01, -0.02, 0.13, 0.3, -0.2, 0.1]
    q = (HOME_Q_RAD + 0.1).tolist()
    seen = wheel.run(
        controller.host,
        CONNECT
        + """
assert control.setTcp(arguments["tool"])
assert control.setPayload(1.5, [0.0, 0.01, 0.05])
while receive.getPayload() != 1.5: time.sleep(0.002)
pose = control.getForwardKinematics(arguments["q"], arguments["tool"])
far = [3.0, 0.0, 0.5, 0.0, 0.0, 0.0]
below = list(pose); below[2] = -0.2
answer(pose=pose, solution=control.getInverseKinematics(pose, arguments["q"]), tcp=receive.getActualTCPPose(),
       offset=control.getTCPOffset(), payload=receive.getPayload(),
       has=[control.getInverseKinematicsHasSolution(pose), control.getInverseKinematicsHasSolution(far)],
       poses=[control.isPoseWithinSafetyLimits(each) for each in (pose, far, below)],
       joints=[control.isJointsWithinSafetyLimits(each) for each in (arguments["q"],
               [6.3, -1.5, 1.5, -1.5, -1.5, 0], [6.4, -1.5, 1.5, -1.5, -1.5, 0], [0, 0.3, 0, 0, 0, 0])],
       trans=control.poseTrans([0.1, 0.2, 0.3, 0, 0, 0], [0.01, 0, 0, 0, 0, 1.0]))
""",
        tool=tool,
        q=q,
    )
    T_flange_tool = pose_matrix(tool)
    np.testing.assert_allclose(pose_matrix(seen["pose"]), ur_kinematics.forward("ur5e", q) @ T_flange_tool, atol=1e-9)
    np.testing.assert_allclose(seen["solution"], q, atol=1e-6)
    home = ur_kinematics.forward("ur5e", HOME_Q_RAD) @ T_flange_tool
    np.testing.assert_allclose(pose_matrix(seen["tcp"]), home, atol=1e-9)
    np.testing.assert_allclose(seen["offset"], tool, atol=1e-9)
    assert seen["payload"] == 1.5
    assert seen["has"] == [True, False]
    assert seen["poses"] == [True, False, False]
    # 6.3 rad are 361 degrees; 6.4 are beyond 363. In the last configuration the arm extends below the plane.
    assert seen["joints"] == [True, True, False, False]
    np.testing.assert_allclose(seen["trans"], [0.11, 0.2, 0.3, 0, 0, 1.0], atol=1e-12)


def test_a_second_control_interface_is_refused_because_of_its_registers(controller: RunningController):
    log = LogSince(controller.admin)
    seen = wheel.run(
        controller.host,
        CONNECT
        + """
try:
    rtde_control.RTDEControlInterface(host)
except Exception as error:
    answer(error=str(error))
answer(error=None)
""",
    )
    assert "One of the RTDE input registers are already in use" in seen["error"]
    assert len(log.events("script_upload")) == 1


def test_in_local_control_the_connection_is_refused_without_an_upload(controller: RunningController):
    log = LogSince(controller.admin)
    controller.admin.local_mode()
    seen = wheel.run(
        controller.host,
        """
try:
    rtde_control.RTDEControlInterface(host)
except Exception as error:
    answer(error=str(error))
answer(error=None)
""",
    )
    assert "remote control" in seen["error"]
    assert log.kinds("script_upload", "script_refused") == []


def test_connecting_kills_a_foreign_program_which_is_logged(controller: RunningController):
    controller.admin.foreign_program("weave.urp")
    log = LogSince(controller.admin)
    seen = wheel.run(controller.host, CONNECT + "answer(running=control.isProgramRunning())")
    assert seen["running"]
    stopped = [event["details"] for event in log.events("program_stopped")]
    assert stopped == [{"name": "weave.urp", "reason": "dashboard stop"}]
    state = controller.admin.state()
    assert (state.program, state.program_state) == ("rtde_control", "PLAYING")


def test_scripts_of_other_clients_run(controller: RunningController):
    log = LogSince(controller.admin)
    wheel.run(
        controller.host,
        """
import socket
with socket.create_connection((host, 30003)) as port:
    port.sendall(b"movej([0,0,0,0,0,0])\\nsec watch():\\n  set_digital_out(1, True)\\nend\\n")
    port.sendall(b"def weave():\\n  sync()\\nend")
    time.sleep(0.2)
answer()
""",
    )
    assert [event["details"]["text"] for event in log.events("script_ignored")] == ["movej([0,0,0,0,0,0])", "watch"]
    assert log.wait("script_upload")["details"]["name"] == "weave"
    assert controller.admin.state().program == "weave"
    assert log.events("motion_start") == []


def test_a_third_party_client_reads_and_writes(controller: RunningController):
    seen = wheel.run(
        controller.host,
        """
from universal_robots_clients import rtde_client as rtde
rtde.configure(host)
rtde.write_speed_slider_fraction(0.25)
rtde.write_input_int_register(42, 17); rtde.write_input_double_register(43, -2.5)
rtde.write_tool_digital_output(1, True)
while rtde.read_speed_slider_percent() > 26.0 or rtde.read_runtime_state() != 1: time.sleep(0.002)
answer(q=rtde.read_actual_joint_positions(), pose=rtde.read_actual_tcp_pose(), mode=rtde.read_robot_mode(),
       safety=rtde.read_safety_mode(), stopped=rtde.is_protective_stopped(), runtime=rtde.read_runtime_state(),
       slider=rtde.read_speed_slider_percent(), connected=rtde.is_connected(),
       register=rtde.read_output_int_register(42))
""",
    )
    np.testing.assert_array_equal(seen["q"], HOME_Q_RAD)
    np.testing.assert_allclose(seen["pose"][:3], ur_kinematics.forward("ur5e", HOME_Q_RAD)[:3, 3], atol=1e-12)
    assert (seen["mode"], seen["safety"], seen["stopped"], seen["runtime"]) == (7, 1, False, 1)
    assert seen["slider"] == pytest.approx(25.0)
    assert seen["connected"]
    assert controller.admin.state().speed_fraction == 0.25
