"""Compare a point chain model with the truth of a simulated scan, or with another model.

In: a model document and a truth document. Out: distances between the lines, the coverage of the true lines, and whether
strings, crossings and over and under are right. `grasp_clearance` judges grasps by the true scene.
"""
