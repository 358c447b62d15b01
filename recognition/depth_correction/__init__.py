"""Errors of the camera that its depth images share: the warp, pixel locking, and the compression of heights.

The input is the table, and the bands of strings, in several depth images. The output is the errors, and depth images
without them. In the images of a single viewpoint, strings are drawn along their bands.
"""
