"""The flange pose of an arm that does not exist: a file that a test writes."""

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class FlangeFile:
    """A `cell.simulation.devices.flange_pose.PoseSource` that can be sent to another process."""

    path: Path

    def __call__(self) -> NDArray[np.float64]:
        """Return the present pose (4, 4) by the last write. Raise OSError if there is none."""
        with np.load(self.path) as moved:
            return moved["after"] if time.monotonic() >= moved["at_s"] else moved["before"]

    def write(self, T_base_flange: NDArray[np.float64], at_s: float = 0.0) -> None:
        """Set the pose from `at_s` on (monotonic seconds; now by default). Until then, the present pose is kept."""
        before = self() if at_s > 0 else T_base_flange
        unfinished = self.path.with_suffix(".new.npz")
        np.savez(unfinished, before=before, after=T_base_flange, at_s=at_s)
        unfinished.replace(self.path)


def flange_file(path: str) -> FlangeFile:
    """Return the pose source of a path, like `controller_pose` for the address of a controller."""
    return FlangeFile(Path(path))
