"""What the driver of a camera must offer. The driver runs in a child process of its own."""

from typing import Literal, Protocol

from cell.devices import Burst, CameraInfo, Frame

Fault = Literal["none", "silent", "zero", "constant", "stale", "lost"]
"""Faults of a simulated camera. `silent` sends nothing; `zero` sends depth without measurements and black images;
`constant` sends one depth and one grey level; `stale` sends old images; `lost` closes the stream."""


class CameraDriver(Protocol):
    """Drive one camera.

    The methods are called one at a time. Their arguments, results and errors must be picklable. A driver imports the
    vendor's library inside its methods, so that the parent process never loads it.
    """

    def open(self) -> CameraInfo:
        """Open the camera, wait for its first image, and let its exposure settle.

        After a lost connection it is called again, on a new driver in a new process.

        Raises:
            CameraUnreachableError: No camera answers, or it sends no images.
        """
        ...

    def capture(self, after_s: float, silence_s: float, patience_s: float, with_image: bool = False) -> Frame:
        """Return the median of the configured number of exposures.

        If the camera sends grey images that are aligned with the depth, the frame has `intensity`, their mean.

        Args:
            after_s: Earliest start of an exposure, seconds of `time.monotonic()`.
            silence_s: Largest time between two images.
            patience_s: Time after which all exposures must be there.
            with_image: Whether the frame has an `image` for a calibration, in place of `intensity`. It is never
                requested from a camera without `CameraInfo.has_images`.

        Raises:
            CameraLostError: The link to the camera broke.
            NoFramesError: The camera is silent. Like a lost camera, it is opened again once.
            BadFrameError: The images show nothing, or too few came.
        """
        ...

    def burst(self, count: int, after_s: float, silence_s: float, patience_s: float) -> Burst:
        """Return single exposures, one after the other, without their median.

        A self-test compares them. An image that shows nothing is not an error.

        Args:
            count: Number of exposures.
            after_s: Earliest start of an exposure, seconds of `time.monotonic()`.
            silence_s: Largest time between two images.
            patience_s: Time after which all exposures must be there.

        Raises:
            CameraLostError: The link to the camera broke.
            NoFramesError: The camera is silent. Like a lost camera, it is opened again once.
            BadFrameError: The images differ in size, or too few came.
        """
        ...

    def info(self) -> CameraInfo:
        """Return the camera's present state.

        Raises:
            CameraLostError: The camera does not answer.
        """
        ...

    def fault(self, kind: Fault) -> None:
        """Make a simulated camera fail from now on.

        Raises:
            CellError: The camera is a real one.
        """
        ...

    def close(self) -> None:
        """Release the camera."""
        ...
