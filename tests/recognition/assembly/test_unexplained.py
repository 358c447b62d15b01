"""Surface above the table that is in no chain is reported."""

from dataclasses import replace

import numpy as np

from recognition.assembly.unexplained import MAX_LISTED_PIECES, find_unexplained_surface
from recognition.assembly.unexplained import unexplained_messages as messages_of
from recognition.model.chains import Chain
from recognition.parameters import ChainParameters


def line(start_mm: tuple[float, float], end_mm: tuple[float, float], spacing_mm: float) -> np.ndarray:
    a, b = np.array([*start_mm, 4.2]) / 1000, np.array([*end_mm, 4.2]) / 1000
    return np.linspace(a, b, round(np.linalg.norm(b - a) / (spacing_mm / 1000)) + 1)


def chain(points: np.ndarray, closed: bool = False) -> Chain:
    count = len(points)
    return Chain(0, closed, 0.0042, points, np.zeros(count), np.ones(count, dtype=np.int64), ("free", "free"))


def unexplained_messages(surface: np.ndarray, chains: list[Chain], parameters: ChainParameters) -> list[str]:
    return messages_of(find_unexplained_surface(surface, chains, parameters))


# Points so far apart that the middles of links are more than 2 r from both.
ALONG_X = chain(line((0, 0), (100, 0), 20))


def test_the_surface_of_a_chain_is_explained(table_1: ChainParameters) -> None:
    beside = line((0, 8), (100, 8), 1)
    assert unexplained_messages(beside, [ALONG_X], table_1) == []


def test_the_surface_of_a_thicker_chain_is_explained(table_1: ChainParameters) -> None:
    beside = line((0, 11), (100, 11), 1)
    assert len(unexplained_messages(beside, [ALONG_X], table_1)) == 1
    assert unexplained_messages(beside, [replace(ALONG_X, radius_m=0.006)], table_1) == []


def test_other_surface_is_reported_with_size_and_position(table_1: ChainParameters) -> None:
    surface = np.vstack([line((0, 4), (100, 4), 1), line((20, 30), (60, 30), 1)])
    (message,) = unexplained_messages(surface, [ALONG_X], table_1)
    assert message == "something of 40 mm at (40, 30, 4) mm is above the table and in no chain"


def test_pieces_smaller_than_r_cn_are_noise(table_1: ChainParameters) -> None:
    # r_cn = 12.6 mm. Two pieces more than r apart are two, even if together they are larger.
    assert unexplained_messages(line((20, 30), (32, 30), 1), [ALONG_X], table_1) == []
    two = np.vstack([line((20, 30), (30, 30), 1), line((35, 30), (45, 30), 1)])
    assert unexplained_messages(two, [ALONG_X], table_1) == []
    assert len(unexplained_messages(line((20, 30), (33, 30), 1), [ALONG_X], table_1)) == 1


def test_the_largest_come_first_and_the_rest_are_counted(table_1: ChainParameters) -> None:
    surface = np.vstack([line((0, 30 + 10 * k), (20 + k, 30 + 10 * k), 1) for k in range(MAX_LISTED_PIECES + 2)])
    messages = unexplained_messages(surface, [ALONG_X], table_1)
    assert [message.split()[2] for message in messages[:MAX_LISTED_PIECES]] == ["26", "25", "24", "23", "22"]
    assert messages[MAX_LISTED_PIECES:] == ["and 2 more such objects"]


def test_a_closed_chain_explains_its_closing_link(table_1: ChainParameters) -> None:
    corners = np.array([(0, 0, 4.2), (60, 0, 4.2), (60, 60, 4.2), (0, 60, 4.2)]) / 1000
    side = line((0, 0), (0, 60), 1)
    assert unexplained_messages(side, [chain(corners, closed=True)], table_1) == []
    assert len(unexplained_messages(side, [chain(corners)], table_1)) == 1


def test_without_chains_all_of_the_surface_is_reported(table_1: ChainParameters) -> None:
    """A table with strings of a radius other than the given one must not look like an empty table."""
    (message,) = unexplained_messages(line((0, 0), (50, 0), 1), [], table_1)
    assert message.startswith("something of 50 mm at (25, 0, ")
    assert unexplained_messages(np.empty((0, 3)), [], table_1) == []
    assert unexplained_messages(np.empty((0, 3)), [ALONG_X], table_1) == []
