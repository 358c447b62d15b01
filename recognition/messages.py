"""How places are named in warnings and ambiguities."""

import numpy as np
from numpy.typing import NDArray


def format_position(point: NDArray[np.float64]) -> str:
    """A `point` (3,) in whole millimetres, as in "(12, -40, 4) mm"."""
    return f"({', '.join(str(round(float(value) * 1000)) for value in point)}) mm"
