"""The RTDE server with an independent client."""

import struct

import numpy as np
import pytest

from cell.simulation.ur_controller.launcher import RunningController
from tests.cell.simulation.ur_controller.cell_log import HOME_Q_RAD, LogSince, wait_for
from tests.cell.simulation.ur_controller.rtde_client import RtdeClient

pytestmark = pytest.mark.xdist_group("cell")  # one at a time, because each test runs several busy processes


def test_protocol_versions_are_accepted_or_refused(controller: RunningController):
    with RtdeClient(controller.host) as client:
        assert struct.unpack(">4I", client.ask("v")) == (5, 25, 1, 0)
        assert client.ask("V", struct.pack(">H", 3)) == b"\x00"


def test_the_state_has_the_types_of_the_protocol(controller: RunningController):
    with RtdeClient(controller.host) as client:
        recipe, types = client.outputs(
            ["timestamp", "actual_q", "actual_TCP_pose", "robot_mode", "safety_mode", "runtime_state", "joint_mode",
             "robot_status_bits", "safety_status_bits", "actual_digital_output_bits", "payload_cog",
             "output_int_register_47", "output_double_register_0", "output_bit_register_64",
             "output_bit_registers0_to_31"]
        )  # fmt: skip
        assert recipe == 1
        assert types == [
            "DOUBLE", "VECTOR6D", "VECTOR6D", "INT32", "INT32", "UINT32", "VECTOR6INT32", "UINT32", "UINT32", "UINT64",
            "VECTOR3D", "INT32", "DOUBLE", "BOOL", "UINT32",
        ]  # fmt: skip
        assert client.start()
        data = client.data()
    np.testing.assert_array_equal(data["actual_q"], HOME_Q_RAD)
    # The upper arm is vertical, the forearm level, and the flange points down.
    np.testing.assert_allclose(data["actual_TCP_pose"][:3], (-0.4919, -0.1333, 0.4879), atol=1e-9)
    assert (data["robot_mode"], data["safety_mode"], data["runtime_state"]) == (7, 1, 1)
    assert (data["robot_status_bits"], data["safety_status_bits"]) == (1, 1)


@pytest.mark.parametrize("name", ["no_such_thing", "output_double_register_48", "output_bit_register_63", ""])
def test_an_unknown_variable_is_not_found_and_the_recipe_does_not_start(controller: RunningController, name: str):
    with RtdeClient(controller.host) as client:
        if name:
            assert client.outputs(["timestamp", name]) == (0, ["DOUBLE", "NOT_FOUND"])
        else:
            assert client.outputs([])[0] == 0
        assert not client.start()
        assert client.inputs(["input_int_register_30", "output_int_register_1"]) == (0, ["INT32", "NOT_FOUND"])


def test_an_input_register_has_one_owner_until_it_disconnects(controller: RunningController):
    names = ["input_int_register_40", "input_double_register_40"]
    with RtdeClient(controller.host) as second:
        with RtdeClient(controller.host) as first:
            assert first.inputs(names) == (1, ["INT32", "DOUBLE"])
            assert first.inputs(names[:1]) == (2, ["INT32"])  # the owner may use its register in several recipes
            assert second.inputs(names) == (0, ["IN_USE", "IN_USE"])
            assert second.inputs(["input_int_register_41"]) == (1, ["INT32"])
        wait_for(lambda: second.inputs(names)[0], "the registers are free again")


def test_written_registers_are_read_back(controller: RunningController):
    with RtdeClient(controller.host) as client:
        recipe, _ = client.inputs(["input_int_register_42", "input_double_register_43", "input_bit_register_70",
                                   "input_bit_registers32_to_63"])  # fmt: skip
        client.write(recipe, "id?I", -7, 2.5, True, 0xDEADBEEF)
        client.outputs(["input_int_register_42", "input_double_register_43", "input_bit_register_70",
                        "input_bit_registers32_to_63"])  # fmt: skip
        client.start()
        assert list(client.data().values()) == [-7, 2.5, True, 0xDEADBEEF]


def test_the_speed_slider_and_digital_outputs_follow_their_masks(controller: RunningController):
    with RtdeClient(controller.host) as client:
        slider, _ = client.inputs(["speed_slider_mask", "speed_slider_fraction"])
        standard, _ = client.inputs(["standard_digital_output_mask", "standard_digital_output"])
        tool, _ = client.inputs(["tool_digital_output_mask", "tool_digital_output"])
        client.write(slider, "Id", 1, 0.4)
        client.write(slider, "Id", 0, 0.9)
        client.write(standard, "BB", 0b0110, 0b1111)
        client.write(tool, "BB", 0b10, 0b11)
        client.outputs(["target_speed_fraction", "actual_digital_output_bits"])
        client.start()
        assert list(client.data().values()) == [0.4, 0b0110 | 0b10 << 16]
        client.write(standard, "BB", 0xFF, 0)
        client.write(tool, "BB", 0xFF, 0)
        wait_for(lambda: client.data()["actual_digital_output_bits"] == 0, "the outputs are off")


def test_a_recipe_beyond_the_size_of_a_package_is_refused(controller: RunningController):
    with RtdeClient(controller.host) as client:
        assert client.outputs(["actual_q"] * 1500)[0] == 0
        assert not client.start()
        assert "do not fit" in client.messages[0]


@pytest.mark.parametrize("hz", [500.0, 125.0])
def test_the_stream_keeps_its_rate_by_the_clock_of_the_controller(controller: RunningController, hz: float):
    with RtdeClient(controller.host) as client:
        client.outputs(["timestamp"], hz)
        client.start()
        stamps = np.array([client.data()["timestamp"] for _ in range(200)])
    gaps = np.diff(stamps)
    assert gaps.min() > 0
    # At most one package more than requested, which follows a late one. A busy machine omits some.
    assert (stamps[-1] - stamps[0]) * hz >= len(gaps) - 2
    assert np.median(gaps) < 3 / hz


def test_the_stream_can_be_paused_and_started_again(controller: RunningController):
    with RtdeClient(controller.host) as client:
        client.outputs(["timestamp"])
        assert client.start()
        client.data()
        assert client.pause()
        client.socket.settimeout(0.3)
        with pytest.raises(TimeoutError):
            client.data()
        client.socket.settimeout(10.0)
        assert client.start()
        client.data()


def test_invalid_packages_are_reported_and_the_connection_continues(controller: RunningController):
    with RtdeClient(controller.host) as client:
        client.write(7, "i", 1)
        recipe, _ = client.inputs(["input_int_register_44"])
        client.write(recipe, "ii", 1, 2)
        client.send("X")
        client.send("O", b"\x00")
        client.send("V", b"\x00")
        client.ask("v")
        assert len(client.messages) == 5
        assert "not set up" in client.messages[0]
        assert "9 bytes; the recipe has 5" in client.messages[1]
        assert "unknown package type 88" in client.messages[2]


def test_an_invalid_rate_is_refused(controller: RunningController):
    with RtdeClient(controller.host) as client:
        for hz in (0.0, -1.0, 501.0, float("nan")):
            client.send("O", struct.pack(">d", hz) + b"timestamp")
            assert client.package("O")[0] == 0


def test_protocol_version_1_has_no_recipe_number_in_its_data(controller: RunningController):
    with RtdeClient(controller.host, version=1) as client:
        client.outputs(["timestamp", "actual_q"])
        client.start()
        np.testing.assert_array_equal(client.data()["actual_q"], HOME_Q_RAD)


def test_a_package_shorter_than_its_head_ends_the_connection(controller: RunningController):
    with RtdeClient(controller.host) as client:
        client.socket.sendall(b"\x00\x02V")
        with pytest.raises(ConnectionError):
            client.package("V")


def test_a_client_that_does_not_read_is_disconnected(controller: RunningController):
    log = LogSince(controller.admin)
    with RtdeClient(controller.host) as client:
        client.outputs([f"output_double_register_{k}" for k in range(48)] * 40)
        client.start()
        log.wait("rtde_overflow")
    assert log.wait("disconnected")["details"]["port"] == 30004


def test_texts_of_clients_are_in_the_log(controller: RunningController):
    log = LogSince(controller.admin)
    with RtdeClient(controller.host) as client:
        client.send("M", b"\x05hello\x04test\x02")
        assert "hello" in log.wait("rtde_text")["details"]["text"]
