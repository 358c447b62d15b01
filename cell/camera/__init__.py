"""The depth camera: an OAK device, reached through depthai in a child process.

In: the camera settings. Out: `Frame`s, each the median of several exposures at rest, and the optics that viewpoints are
planned with.
"""
