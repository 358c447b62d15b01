"""Recognise depth images of your own: write them as a folder, import the folder, recognise the recording.

The depth images, poses and camera matrix come from a simulated scan here. Replace `frames()` by your own data.

    python import_own_frames.py

The program writes into a new temporary folder and prints its name.
"""

import json
import subprocess
import tempfile
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from cell.recording import read_recording

TABLE_Z_M = 0.0
RADIUS_M = 0.0042


def frames(folder: Path) -> tuple[list[NDArray[np.uint16]], list[NDArray[np.float64]], NDArray[np.float64]]:
    """Return depth images (H, W) in counts of 0.1 mm, camera poses T_base_camera (4, 4), and K (3, 3)."""
    scan = folder / "scan.mcap"
    subprocess.run(["pointchain", "simulate", "--scene", "loop", str(scan)], check=True)
    views = read_recording(scan).views
    return [view.depth for view in views], [view.T_base_camera for view in views], views[0].K


def write_folder(
    folder: Path, depths: list[NDArray[np.uint16]], poses: list[NDArray[np.float64]], K: NDArray[np.float64]
) -> None:
    """Write 16-bit PNG files, `poses.json` in their order, and `camera.json`."""
    folder.mkdir()
    for index, depth in enumerate(depths):
        cv2.imwrite(str(folder / f"{index:03}.png"), depth)
    (folder / "poses.json").write_text(json.dumps([pose.tolist() for pose in poses]))
    height, width = depths[0].shape
    camera = {"width": width, "height": height, "K": K.tolist(), "depth_unit_m": 0.0001}
    (folder / "camera.json").write_text(json.dumps(camera))


def main() -> None:
    """Write, import and recognise."""
    folder = Path(tempfile.mkdtemp(prefix="own-frames-"))
    write_folder(folder / "frames", *frames(folder))
    recording = folder / "own.mcap"
    command = ["pointchain", "import", "frames", str(folder / "frames"), str(recording)]
    subprocess.run([*command, f"--radius={RADIUS_M}", f"--table-z={TABLE_Z_M}"], check=True)
    done = subprocess.run(["pointchain", "recognise", str(recording)], check=True, stdout=subprocess.PIPE)
    model = json.loads(done.stdout)
    print(f"{recording}: {len(model['chains'])} strings, {len(model['crossings'])} crossings")


if __name__ == "__main__":
    main()
