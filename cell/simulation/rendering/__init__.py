"""Rendering of depth and intensity images of a scene.

In: a scene and a camera pose. Out: the depth that a stereo camera matches in its rendered images, or exact depth with
the noise of a stereo camera, and intensity images.
"""
