"""Ingestion of the views, one by one, while the arm moves to the next viewpoint.

Depth images with their camera poses go in. The warp of the camera, the pose of the table, and preprocessed views with
their correspondences come out, ready for registration.
"""
