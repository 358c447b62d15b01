"""Where the camera is: rigid transforms now, board detection and hand-eye calibration on top of them.

Knows nothing of the cell, the service or file formats of recordings.
"""
