"""Where the camera is: rigid transforms, and the hand-eye calibration's file.

Knows nothing of the cell, the service or file formats of recordings.
"""
