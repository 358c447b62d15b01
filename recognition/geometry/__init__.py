"""Geometry that several stages share.

Points, polylines or graphs go in, as arrays.
Arc lengths, neighbourhoods, voxels, planar intersections or matched pairs come out, as arrays.
"""
