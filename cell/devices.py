"""What the cell's devices deliver, whether live, simulated or recorded."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from calibration.transforms import rigid


class InvalidViewError(ValueError):
    """A view whose parts do not fit together."""

    slug = "invalid-view"


@dataclass(frozen=True, eq=False)
class View:
    """One depth image and where it was taken. Checked when made.

    Raises:
        InvalidViewError: depth or K of the wrong type or shape, or values that no camera has.
        NotRigidError: a pose that is not a rigid transform.
    """

    index: int
    """Which of the scan's viewpoints, from 0."""
    depth: NDArray[np.uint16]
    """(H, W), in units of `depth_unit_m` along the optical axis; 0 = not measured."""
    depth_unit_m: float
    """Metres per depth count."""
    K: NDArray[np.float64]
    """(3, 3) pinhole matrix of the depth image, pixels."""
    T_base_flange: NDArray[np.float64]
    """Flange pose read while the arm was at rest."""
    T_flange_camera: NDArray[np.float64]
    """Hand-eye calibration. Camera frame: x right, y down, z forward."""
    stamp_s: float = 0.0
    """When the frame was exposed, seconds since the epoch."""
    colour_jpeg: bytes | None = field(default=None, repr=False)
    """Colour image of the same moment, JPEG."""

    def __post_init__(self) -> None:
        where = f"view {self.index}"
        if not isinstance(self.depth, np.ndarray) or self.depth.dtype != np.uint16 or self.depth.ndim != 2:
            what = (
                f"{self.depth.dtype} {self.depth.shape}"
                if isinstance(self.depth, np.ndarray)
                else type(self.depth).__name__
            )
            raise InvalidViewError(f"{where}: depth is {what}; a (H, W) array of uint16 is needed")
        if self.depth.size == 0:
            raise InvalidViewError(f"{where}: the depth image is empty")
        if not (np.isfinite(self.depth_unit_m) and 1e-6 <= self.depth_unit_m <= 0.01):
            raise InvalidViewError(f"{where}: depth unit {self.depth_unit_m!r} m; from 1e-6 to 0.01 is taken")
        K = np.asarray(self.K, dtype=np.float64)
        if K.shape != (3, 3) or not np.isfinite(K).all():
            raise InvalidViewError(f"{where}: K must be a finite 3x3 matrix, got {K.tolist()}")
        height, width = self.depth.shape
        fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
        if not (fx > 0 and fy > 0):
            raise InvalidViewError(f"{where}: K has focal lengths {fx:g}, {fy:g}; not a camera's")
        if not np.array_equal(K, [(fx, 0, cx), (0, fy, cy), (0, 0, 1)]):
            raise InvalidViewError(f"{where}: K is {K.tolist()}; [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] is needed")
        if not (0 < cx < width and 0 < cy < height):
            raise InvalidViewError(
                f"{where}: K has its centre at ({cx:g}, {cy:g}), outside the {width}x{height} depth image: "
                "the calibration is of another resolution"
            )
        object.__setattr__(self, "K", K)
        object.__setattr__(self, "T_base_flange", rigid(self.T_base_flange, f"{where}: T_base_flange"))
        object.__setattr__(self, "T_flange_camera", rigid(self.T_flange_camera, f"{where}: T_flange_camera"))

    @property
    def T_base_camera(self) -> NDArray[np.float64]:
        """Maps camera points to base."""
        return self.T_base_flange @ self.T_flange_camera
