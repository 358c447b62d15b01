"""The depth images of a folder, in the order of the numbers in their names."""

import re
from pathlib import Path

from cell.frames.errors import FramesError
from cell.recording.limits import DEFAULT_LIMITS

IMAGES = (".png", ".npy")
"""Formats of depth images that are read."""
IGNORED = (".json", ".txt", ".md", ".csv", ".yaml", ".yml")
"""Poses, the camera matrix and notes."""
KINDS = {
    ".bmp": "a colour or grey picture",
    ".exr": "an OpenEXR image",
    ".jpeg": "a JPEG picture, which cannot hold depth",
    ".jpg": "a JPEG picture, which cannot hold depth",
    ".npz": "an archive of arrays",
    ".pgm": "a PGM image",
    ".tif": "a TIFF image",
    ".tiff": "a TIFF image",
}
"""Other files that such folders often hold."""


def depth_images(folder: Path) -> list[Path]:
    """Return the paths of the depth images in `folder`. Hidden files and subfolders are ignored.

    Raises:
        FramesError: There is no such folder, it cannot be read, or it holds no or too many images, or another file.
    """
    if not folder.is_dir():
        raise FramesError(f"{folder} is not a folder: name the folder that holds the depth images")
    try:
        files = sorted((path for path in folder.iterdir() if not path.name.startswith(".")), key=natural_order)
    except OSError as error:
        raise FramesError(f"{folder} cannot be read: {error.strerror or error}") from error
    images = [path for path in files if path.is_file() and path.suffix.lower() in IMAGES]
    if not images:
        folders = [path.name for path in files if path.is_dir()]
        inside = f"; it holds the folders {', '.join(folders[:10])}: name the one with the images" if folders else ""
        raise FramesError(f"{folder} holds no depth images (16-bit .png or .npy){inside}")
    for path in files:
        if path.is_file() and path.suffix.lower() not in (*IMAGES, *IGNORED):
            what = KINDS.get(path.suffix.lower(), "not in a format that is read here")
            raise FramesError(
                f"{path} is {what}: move it out of the folder, or save its depth as a 16-bit PNG or as NPY"
            )
    if len({path.suffix.lower() for path in images}) > 1:
        raise FramesError(f"{folder} holds both .png and .npy files: keep the depth images of one kind in it")
    if len(images) > DEFAULT_LIMITS.views:
        raise FramesError(
            f"{folder} holds {len(images)} depth images; a recording takes at most {DEFAULT_LIMITS.views} views"
        )
    return images


def natural_order(path: Path) -> list[tuple[int, int, str]]:
    """Sort key of a file name by which 2 comes before 10."""
    parts = re.split(r"(\d+)", path.name)
    return [(0, int(part), "") if part.isascii() and part.isdigit() else (1, 0, part) for part in parts]
