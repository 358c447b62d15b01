"""Depth images and poses in a folder, as a recording.

A folder of depth images (16-bit PNG, or NPY), the camera matrix and a pose for each image go in; a recording comes
out. `import_frames` does it, and `FramesRequest` holds what its caller knows.
"""

from cell.frames.errors import FramesError
from cell.frames.import_frames import FramesRequest, ImportedFrames, import_frames

__all__ = ["FramesError", "FramesRequest", "ImportedFrames", "import_frames"]
