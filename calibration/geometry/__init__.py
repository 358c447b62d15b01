"""Rigid transforms: rotations, translations and points go in; checked (4, 4) matrices and mapped points come out.

`transforms` handles single transforms; this package exports its functions. `se3` handles stacks of transforms and
their small changes, for the solvers.
"""

from calibration.geometry.transforms import (
    NotRigidError,
    from_quaternion,
    from_rotation_vector,
    inverse,
    rigid,
    rotation_angle,
    to_quaternion,
    transform_points,
    with_nearest_rotation,
)

__all__ = [
    "NotRigidError",
    "from_quaternion",
    "from_rotation_vector",
    "inverse",
    "rigid",
    "rotation_angle",
    "to_quaternion",
    "transform_points",
    "with_nearest_rotation",
]
