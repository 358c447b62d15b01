"""Rendering of depth and intensity images of a scene.

In: a scene and a camera pose. Out: images with the noise of a stereo camera.
"""
