"""What the driver of an arm must offer. The driver runs in a child process of its own."""

from typing import Protocol

from cell.arm.rtde_state import RtdeState


class ArmDriver(Protocol):
    """Drive one arm over one connection.

    The constructor takes the address and the watchdog frequency, and connects. The methods are called one at a time.
    Their arguments, results and errors must be picklable. A driver never connects again and never repeats a move.
    """

    def poll(self) -> RtdeState:
        """Return what the controller reports now, and keep the watchdog of a moving arm alive.

        Raises:
            RobotLostError: The link broke.
        """
        ...

    def allows(self, q_rad: tuple[float, ...]) -> bool:
        """Return whether the joint angles (6,) are within the safety limits of the controller.

        Raises:
            RobotLostError: The link broke.
        """
        ...

    def start_move(self, q_rad: tuple[float, ...], speed_rad_s: float, acceleration_rad_s2: float) -> int:
        """Start a joint move and return at once.

        Args:
            q_rad: Target joint angles (6,).
            speed_rad_s: Speed of the fastest joint.
            acceleration_rad_s2: Acceleration of the fastest joint.

        Returns:
            Number of the previous operation. The number of the new one differs from it.

        Raises:
            RobotNotReadyError: The controller rejects the move.
            RobotLostError: The link broke.
            StoppedError: `stop` was called before.
        """
        ...

    def stop(self, deceleration_m_s2: float) -> None:
        """Stop the arm, and send no move afterwards.

        Raises:
            RobotLostError: The link broke.
        """
        ...

    def at_rest(self) -> tuple[RtdeState, tuple[float, ...]]:
        """Return what the controller reports of an arm at rest, and the pose of the tool (6,) on the flange.

        The tool's pose is its position in metres, followed by its rotation vector in radians.

        Raises:
            RobotLostError: The link broke, or the tool changes.
        """
        ...

    def alive(self) -> None:
        """Receive that the parent process is alive."""
        ...

    def idle(self, quiet_s: float) -> None:
        """Keep the watchdog of a resting arm alive. It is called between the other calls.

        Args:
            quiet_s: Time since the last call of the parent. After several seconds the watchdog is no longer kept alive.
        """
        ...

    def end_program(self) -> bool:
        """End the program on the controller, and with it any motion. Return whether it has ended.

        Raises:
            RobotLostError: The link broke.
        """
        ...

    def close(self) -> None:
        """Release the connection."""
        ...
