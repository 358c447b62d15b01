"""Messages about bends that a string does not make."""

import numpy as np

from recognition.assembly.sharp_bends import sharp_bend_messages
from recognition.geometry.polyline import arc_length, points_at
from recognition.model.chains import Chain
from recognition.parameters import ChainParameters


def chain(table_1: ChainParameters, *corners_mm: tuple[float, float]) -> Chain:
    """Return an open chain through the corners, with points 4.2 mm apart."""
    corners = np.array([(x, y, 4.2) for x, y in corners_mm]) / 1000
    s = arc_length(corners)
    points = points_at(corners, np.linspace(0, s[-1], round(s[-1] / 0.0042) + 1))
    n = len(points)
    return Chain(0, False, table_1.r, points, np.full(n, 0.0002), np.ones(n, dtype=np.int64), ("free", "free"))


def bends(degrees: float, table_1: ChainParameters) -> list[str]:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return sharp_bend_messages([chain(table_1, (0, 0), (50.4, 0), (50.4 + 50.4 * c, 50.4 * s))])


def test_a_sharp_bend_gives_a_message_with_its_position(table_1: ChainParameters) -> None:
    (message,) = bends(100, table_1)
    assert message.startswith("chain 0 bends sharply at (50, 0, 4) mm")
    assert bends(60, table_1) == []
    assert bends(0, table_1) == []


def test_a_short_chain_has_no_bend(table_1: ChainParameters) -> None:
    assert sharp_bend_messages([chain(table_1, (0, 0), (13, 0))]) == []
    assert sharp_bend_messages(()) == []
