"""Format of positions in messages."""

import numpy as np
from numpy.typing import NDArray


def format_position(point: NDArray[np.float64]) -> str:
    """Format a position in whole millimetres, for example "(12, -40, 4) mm".

    Args:
        point: (3,) position, metres.
    """
    return f"({', '.join(str(round(float(value) * 1000)) for value in point)}) mm"
