"""Format of positions in messages."""

import numpy as np

from recognition.messages import format_position


def test_positions_are_whole_millimetres_without_a_negative_zero() -> None:
    assert format_position(np.array([0.0123, -0.0401, -0.0002])) == "(12, -40, 0) mm"
