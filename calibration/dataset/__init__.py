"""Files of a calibration: a folder of images and flange poses goes in, the observations for the solver come out.

`folder` reads and writes the folder, and `view_detection` detects the board in the images. `observations_file` stores
the detected corners. A calibration can be solved again from the stored corners, without the images.
"""

from calibration.dataset.folder import FolderContent, FolderView, read_folder, read_setup, write_setup, write_view
from calibration.dataset.observations_file import StoredObservations, load_observations, write_observations
from calibration.dataset.setup import Setup
from calibration.dataset.view_detection import DetectedViews, detect_views, read_image

__all__ = [
    "DetectedViews",
    "FolderContent",
    "FolderView",
    "Setup",
    "StoredObservations",
    "detect_views",
    "load_observations",
    "read_folder",
    "read_image",
    "read_setup",
    "write_observations",
    "write_setup",
    "write_view",
]
