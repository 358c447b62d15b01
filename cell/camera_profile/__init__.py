"""Character of a depth camera: its noise, pixel locking, warp and holes, measured on a flat table.

In: depth images of a table from one or several poses. Out: a profile, and its comparison with an expected one. A camera
file holds the parameters of a simulated camera that reproduces a profile.
"""
