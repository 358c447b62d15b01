"""Where the flange of an arm that is not there is: in a file that a test writes."""

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class FlangeFile:
    """A `cell.simulation.devices.flange_pose.PoseSource` that another process can take along."""

    path: Path

    def __call__(self) -> NDArray[np.float64]:
        """The pose (4, 4) now, by what was written last. Raises OSError."""
        with np.load(self.path) as moved:
            return moved["after"] if time.monotonic() >= moved["at_s"] else moved["before"]

    def write(self, T_base_flange: NDArray[np.float64], at_s: float = 0.0) -> None:
        """The flange is there from `at_s` of `time.monotonic()` on, now unless given; until then where it is now."""
        before = self() if at_s > 0 else T_base_flange
        unfinished = self.path.with_suffix(".new.npz")
        np.savez(unfinished, before=before, after=T_base_flange, at_s=at_s)
        unfinished.replace(self.path)


def flange_file(path: str) -> FlangeFile:
    """As `controller_pose`, with a path in place of a controller's address."""
    return FlangeFile(Path(path))
