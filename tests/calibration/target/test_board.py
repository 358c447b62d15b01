"""Boards are valid, or rejected with the reason."""

import cv2
import numpy as np
import pytest

from calibration.target.board import MARKER_COUNTS, Board, BoardError, board_with_defaults
from calibration.target.rendering import render_board

BOARDS = [
    Board(),
    Board("charuco", 8, 5, 0.033, 0.025, "DICT_5X5_100"),
    Board("checkerboard", 10, 7, 0.025),
    Board("circles", 9, 11, 0.02),
]


@pytest.mark.parametrize("board", BOARDS, ids=str)
def test_from_json_inverts_to_json(board: Board):
    assert Board.from_json(board.to_json()) == board


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"kind": "april"}, "charuco, checkerboard, circles"),
        ({"columns": 2}, "2 columns: use a whole number from 3"),
        ({"columns": 9.0}, "9.0 columns"),
        ({"columns": True}, "True columns"),
        ({"rows": 6}, "6 rows: an odd number"),
        ({"pitch_m": 26.0, "marker_m": 20.0}, "looks like millimetres"),
        ({"pitch_m": 0.0}, "pitch_m is 0 m"),
        ({"pitch_m": float("nan")}, "a number of metres"),
        ({"pitch_m": "26"}, "a number of metres"),
        ({"marker_m": 0.026}, "must be smaller than the squares"),
        ({"marker_m": 0.002}, "at least 30% of their side"),
        ({"dictionary": "DICT_4X4"}, "no dictionary 'DICT_4X4'"),
        ({"columns": 21}, "73 markers, and DICT_4X4_50 has 50"),
        ({"columns": 3, "rows": 3}, "has 4 corners, and at least 6 are needed"),
    ],
)
def test_invalid_boards_are_rejected(change: dict, words: str):
    with pytest.raises(BoardError) as error:
        Board(**change)
    assert words in str(error.value)
    assert error.value.slug == "calibration-board"


@pytest.mark.parametrize(
    ("document", "words"),
    [
        ([1, 2], "an object with kind"),
        ({"kind": "charuco", "columns": 9, "rows": 7, "pitch_m": 0.026}, "has no dictionary, marker_m"),
        ({"kind": "circles", "columns": 9, "rows": 7, "pitch": 0.02}, "has no pitch_m"),
        ({"kind": "circles", "columns": 9, "rows": 7, "pitch_m": 0.02, "marker_m": 0.01}, "unknown members (marker_m)"),
        ({"kind": ["charuco"], "columns": 9, "rows": 7, "pitch_m": 0.02}, "kind is \"['charuco']\""),
    ],
)
def test_invalid_documents_are_rejected(document: object, words: str):
    with pytest.raises(BoardError) as error:
        Board.from_json(document)
    assert words in str(error.value)


def test_even_rows_are_rejected_for_charuco_only():
    assert Board("checkerboard", 9, 6, 0.025).rows == 6
    assert Board("circles", 4, 10, 0.02).rows == 10


def test_marker_dictionaries_are_those_of_opencv():
    for name, count in MARKER_COUNTS.items():
        assert len(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name)).bytesList) == count, name


def test_the_points_are_the_corners_of_opencv():
    board = Board()
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    opencv = cv2.aruco.CharucoBoard((board.columns, board.rows), board.pitch_m, board.marker_m, dictionary)
    corners = np.array(opencv.getChessboardCorners()) + [*board.print_corner, 0.0]
    np.testing.assert_allclose(board.points, corners, atol=1e-8)  # OpenCV uses float32


def test_z_points_into_the_paper():
    # Seen from the front, x points right and y down, so z points along the line of sight.
    board = Board()
    picture = render_board(board, 30)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    opencv = cv2.aruco.CharucoBoard((board.columns, board.rows), board.pitch_m, board.marker_m, dictionary)
    corners, ids, _, _ = cv2.aruco.CharucoDetector(opencv).detectBoard(picture.pixels)
    assert len(ids) == len(board.points)
    K = np.array([[1000.0, 0, 150], [0, 1000.0, 120], [0, 0, 1]])
    _, rotation, _ = cv2.solvePnP(board.points[np.asarray(ids, dtype=int).ravel()], corners, K, np.zeros(0))
    np.testing.assert_allclose(cv2.Rodrigues(rotation)[0], np.eye(3), atol=0.01)


@pytest.mark.parametrize("kind", ["checkerboard", "circles"])
def test_marker_fields_of_a_board_without_markers_are_ignored(kind: str) -> None:
    board = board_with_defaults({"kind": kind, "pitch_m": 0.03, "marker_m": 0.02, "dictionary": "DICT_5X5_50"})
    assert board == board_with_defaults({"kind": kind, "pitch_m": 0.03})
    assert board == Board.from_json(board.to_json())
