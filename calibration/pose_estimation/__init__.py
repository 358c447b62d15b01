"""Projection of board corners, and the pose of a board from its corners."""
