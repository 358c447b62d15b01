"""From a calibration and new views of the board to whether the calibration still holds."""
