"""Geometry that several stages share.

The input is points, polylines or graphs, as arrays. The output is arc lengths, neighbourhoods, voxels, planar
intersections or matched pairs, as arrays.
"""
