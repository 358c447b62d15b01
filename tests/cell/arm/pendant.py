"""Actions of an operator at the pendant, by ur_rtde, in a child process because ur_rtde may hang."""


class Pendant:
    """Driver for `cell.process.child`."""

    def __init__(self, host: str) -> None:
        self._host = host

    def set_tool(self, flange_tool: tuple[float, ...]) -> None:
        """Set the tool (6,) of the installation, metres and axis-angle. No other program may drive the robot."""
        from rtde_control import RTDEControlInterface

        control = RTDEControlInterface(self._host)
        if not control.setTcp(list(flange_tool)):
            raise RuntimeError("the tool could not be set")
        control.stopScript()

    def hold(self) -> None:
        """Start another program on the robot that does nothing."""
        from rtde_control import RTDEControlInterface

        self._held = RTDEControlInterface(self._host)

    def let_go(self) -> None:
        """End that program."""
        self._held.stopScript()

    def slide_speed(self, fraction: float) -> None:
        """Set the speed slider, 0 to 1."""
        from rtde_io import RTDEIOInterface

        if not RTDEIOInterface(self._host).setSpeedSlider(fraction):
            raise RuntimeError("the speed could not be set")

    def close(self) -> None:
        """Do nothing: the process ends."""
