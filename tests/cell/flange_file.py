"""Where the flange of an arm that is not there is: in a file that a test writes."""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class FlangeFile:
    """A `cell.simulation.flange.PoseSource` that another process can take along."""

    path: Path

    def __call__(self) -> NDArray[np.float64]:
        """The pose (4, 4) that was written last. Raises OSError."""
        return np.load(self.path)

    def write(self, T_base_flange: NDArray[np.float64]) -> None:
        """From now on the flange is there."""
        unfinished = self.path.with_suffix(".new.npy")
        np.save(unfinished, T_base_flange)
        os.replace(unfinished, self.path)  # noqa: PTH105


def flange_file(path: str) -> FlangeFile:
    """As `controller_pose`, with a path in place of a controller's address."""
    return FlangeFile(Path(path))
