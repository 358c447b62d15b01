"""What an operator does at the pendant, done with ur_rtde; in a child process, since that may hang."""


class Pendant:
    """A driver for `cell.process.child`."""

    def __init__(self, host: str) -> None:
        self._host = host

    def set_tool(self, flange_tool: tuple[float, ...]) -> None:
        """Metres and axis-angle, (6,), as in the installation: it stays. Nothing else may drive the robot."""
        from rtde_control import RTDEControlInterface

        control = RTDEControlInterface(self._host)
        if not control.setTcp(list(flange_tool)):
            raise RuntimeError("the tool was not taken")
        control.stopScript()

    def hold(self) -> None:
        """Another program takes the robot, and does nothing with it."""
        from rtde_control import RTDEControlInterface

        self._held = RTDEControlInterface(self._host)

    def let_go(self) -> None:
        """Ends that program."""
        self._held.stopScript()

    def slide_speed(self, fraction: float) -> None:
        """The speed slider, 0 to 1."""
        from rtde_io import RTDEIOInterface

        if not RTDEIOInterface(self._host).setSpeedSlider(fraction):
            raise RuntimeError("the speed was not taken")

    def close(self) -> None:
        """The process is just ended."""
