"""Geometry that several stages share: polylines, neighbourhoods, voxels, planar intersections, matching in graphs."""
