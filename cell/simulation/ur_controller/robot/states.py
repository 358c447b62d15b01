"""Numbers of the controller's states, as on the wire."""

from enum import IntEnum


class RobotMode(IntEnum):
    """Robot mode, RTDE's robot_mode."""

    NO_CONTROLLER = -1
    DISCONNECTED = 0
    CONFIRM_SAFETY = 1
    BOOTING = 2
    POWER_OFF = 3
    POWER_ON = 4
    IDLE = 5
    BACKDRIVE = 6
    RUNNING = 7
    UPDATING_FIRMWARE = 8


class SafetyMode(IntEnum):
    """Safety mode, RTDE's safety_mode."""

    NORMAL = 1
    REDUCED = 2
    PROTECTIVE_STOP = 3
    RECOVERY = 4
    SAFEGUARD_STOP = 5
    SYSTEM_EMERGENCY_STOP = 6
    ROBOT_EMERGENCY_STOP = 7
    VIOLATION = 8
    FAULT = 9

    @property
    def bits(self) -> int:
        """RTDE's safety_status_bits."""
        return _BITS[self]


def _bits(mode: SafetyMode) -> int:
    word = 1 << (mode - 1) if mode < SafetyMode.VIOLATION else 1 << mode
    if mode in (SafetyMode.SYSTEM_EMERGENCY_STOP, SafetyMode.ROBOT_EMERGENCY_STOP):
        word |= 1 << 7  # emergency stopped
    if mode not in (SafetyMode.NORMAL, SafetyMode.REDUCED):
        word |= 1 << 10  # stopped due to safety
    return word


_BITS = {mode: _bits(mode) for mode in SafetyMode}


class OperationalMode(IntEnum):
    """Operational mode, as the dashboard reports it."""

    NONE = -1
    MANUAL = 0
    AUTOMATIC = 1


class RuntimeState(IntEnum):
    """State of the program, RTDE's runtime_state."""

    STOPPING = 0
    STOPPED = 1
    PLAYING = 2
    PAUSING = 3
    PAUSED = 4
    RESUMING = 5
