"""Where the camera is on the flange: boards and how they are found, the solver, what refuses its result, the files of a
calibration, and whether one in use still holds. Rigid transforms, which all packages use, are here too.

`hand_eye.solve_hand_eye` is where to begin reading. Knows nothing of the cell, the service or the form of recordings.
"""
