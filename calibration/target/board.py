"""Calibration boards: kinds, sizes and corner positions in the board frame."""

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

BoardKind = Literal["charuco", "checkerboard", "circles"]

BOARD_KINDS: tuple[BoardKind, ...] = ("charuco", "checkerboard", "circles")

# A table instead of a query to OpenCV, because importing OpenCV is slow.
MARKER_COUNTS = {
    **{f"DICT_{size}_{count}": count for size, count in product(("4X4", "5X5", "6X6", "7X7"), (50, 100, 250, 1000))},
    "DICT_ARUCO_ORIGINAL": 1024,
    "DICT_APRILTAG_16h5": 30,
    "DICT_APRILTAG_25h9": 35,
    "DICT_APRILTAG_36h10": 2320,
    "DICT_APRILTAG_36h11": 587,
    "DICT_ARUCO_MIP_36h12": 250,
}
"""Number of markers in each marker dictionary of OpenCV."""

MIN_PITCH_M, MAX_PITCH_M = 0.001, 0.5
"""Range of the pitch and of the marker side, metres. A value outside this range is probably in another unit."""
MAX_PER_SIDE = 100
"""Maximum number of squares or dots along a side."""
MIN_PER_SIDE = {"charuco": 3, "checkerboard": 4, "circles": 3}
"""Minimum number of squares or dots along a side. The detected points (inner corners or dots) must not lie on one line.
OpenCV detects a checkerboard only with at least 3 x 3 inner corners."""
MIN_MARKER_SHARE = 0.3
"""Minimum ratio of the marker side to the square side. A smaller marker is readable only at a short distance."""
MIN_CORNERS = 6
"""Minimum number of corners of a board, and of visible corners in a view. Three corners determine the six unknowns of a
pose, but leave no redundancy for a check."""


class BoardError(ValueError):
    """The description of a board is not valid."""

    slug = "calibration-board"


@dataclass(frozen=True)
class Board:
    """A flat calibration board.

    The origin of the board frame is the first inner corner (or dot), at the top left of the print. x points along a
    row, y points to the next row, and z = x cross y points into the paper. OpenCV uses the same axes, but its ChArUco
    origin is one square further up and to the left. The top left square of a checkerboard or ChArUco board is black.
    A circle grid may have one larger dot, which is then the first dot.

    The default board, with its white margin, fits on A4 and letter paper. The distances below are for a camera with
    640x400 pixels and a focal length of 402 px, and a board that is tilted by 30 degrees. The camera sees the whole
    board at 0.36 m and farther away, and detects all corners up to 0.8 m. If the image is slightly out of focus, it
    detects them up to 0.6 m. Smaller squares (25 mm, markers of 18 mm) are hard to read from 0.6 m on.

    Raises:
        BoardError: A kind, size or count is not valid, or the dictionary is unknown or has too few markers.
    """

    kind: BoardKind = "charuco"
    """`charuco`, `checkerboard` or `circles`."""
    columns: int = 9
    """Number of squares in a row (checkerboard, ChArUco), or of dots in a row (circle grid)."""
    rows: int = 7
    """Number of rows of squares or dots. It is odd for ChArUco, because OpenCV has two layouts for an even number."""
    pitch_m: float = 0.026
    """Side of a square, or distance between the centres of neighbouring dots, measured on the print, metres."""
    marker_m: float = 0.02
    """Side of a ChArUco marker, metres."""
    dictionary: str = "DICT_4X4_50"
    """OpenCV name of the marker dictionary of a ChArUco board."""

    def __post_init__(self) -> None:
        if self.kind not in BOARD_KINDS:
            raise BoardError(f"the board kind is {str(self.kind)[:40]!r}: use one of {', '.join(BOARD_KINDS)}")
        min_count = MIN_PER_SIDE[self.kind]
        for name, count in (("columns", self.columns), ("rows", self.rows)):
            if isinstance(count, bool) or not isinstance(count, int) or not min_count <= count <= MAX_PER_SIDE:
                raise BoardError(
                    f"the board has {str(count)[:40]} {name}: use a whole number from {min_count} to {MAX_PER_SIDE} "
                    f"for the kind {self.kind}"
                )
        _check_length("pitch_m", self.pitch_m)
        if self.kind == "charuco":
            self._check_markers()
        else:  # A board without markers ignores both fields. The defaults make equal boards compare equal.
            object.__setattr__(self, "marker_m", Board.marker_m)
            object.__setattr__(self, "dictionary", Board.dictionary)
        if len(self.points) < MIN_CORNERS:
            raise BoardError(
                f"a {self.kind} board of {self.columns} x {self.rows} has {len(self.points)} corners, and at least "
                f"{MIN_CORNERS} are needed: use more columns or rows"
            )

    def _check_markers(self) -> None:
        if self.rows % 2 == 0:
            raise BoardError(
                f"the ChArUco board has {self.rows} rows: an odd number is needed, because boards with an even number "
                "are printed in two layouts, and a board of the other layout is not detected"
            )
        _check_length("marker_m", self.marker_m)
        if not MIN_MARKER_SHARE * self.pitch_m <= self.marker_m < self.pitch_m:
            raise BoardError(
                f"marker_m is {self.marker_m:g} m and pitch_m is {self.pitch_m:g} m: markers must be smaller than the "
                f"squares and have at least {MIN_MARKER_SHARE:.0%} of their side"
            )
        if not isinstance(self.dictionary, str) or self.dictionary not in MARKER_COUNTS:
            raise BoardError(
                f"OpenCV has no dictionary {str(self.dictionary)[:40]!r}: use one of {', '.join(MARKER_COUNTS)}"
            )
        needed = self.columns * self.rows // 2
        if needed > MARKER_COUNTS[self.dictionary]:
            raise BoardError(
                f"a ChArUco board of {self.columns} x {self.rows} has {needed} markers, and {self.dictionary} has "
                f"{MARKER_COUNTS[self.dictionary]}: use a larger dictionary or fewer squares"
            )

    @property
    def shape(self) -> tuple[int, int]:
        """Number of columns and number of rows of the detected points (inner corners or dots)."""
        inner = 0 if self.kind == "circles" else 1
        return self.columns - inner, self.rows - inner

    @property
    def points(self) -> NDArray[np.float64]:
        """(N, 3) inner corners or dots, row by row, metres, board frame. The number of a corner is its index here."""
        columns, rows = self.shape
        x, y = np.meshgrid(np.arange(columns, dtype=np.float64), np.arange(rows, dtype=np.float64))
        points = np.zeros((x.size, 3))
        points[:, 0] = x.ravel() * self.pitch_m
        points[:, 1] = y.ravel() * self.pitch_m
        return points

    @property
    def size_m(self) -> tuple[float, float]:
        """Width and height of the print without white margin, metres.

        The print of a circle grid ends half a pitch beyond the centres of the outer dots.
        """
        return self.columns * self.pitch_m, self.rows * self.pitch_m

    @property
    def print_corner(self) -> tuple[float, float]:
        """(x, y) of the top left corner of the print, metres, board frame."""
        before = self.pitch_m / 2 if self.kind == "circles" else self.pitch_m
        return -before, -before

    def __str__(self) -> str:
        size = f"{self.kind} {self.columns} x {self.rows}, pitch {self.pitch_m * 1e3:g} mm"
        if self.kind == "charuco":
            return f"{size}, markers {self.marker_m * 1e3:g} mm, {self.dictionary}"
        return size

    def to_json(self) -> dict[str, Any]:
        """Return the board as a JSON object. Only a ChArUco board has `marker_m` and `dictionary`."""
        document: dict[str, Any] = {
            "kind": self.kind,
            "columns": self.columns,
            "rows": self.rows,
            "pitch_m": self.pitch_m,
        }
        if self.kind == "charuco":
            document |= {"marker_m": self.marker_m, "dictionary": self.dictionary}
        return document

    @classmethod
    def from_json(cls, document: object) -> "Board":
        """Create a board from a JSON object, as returned by `to_json`.

        Args:
            document: The JSON object. Every member is required.

        Raises:
            BoardError: The document is not an object, a member is missing or unknown, or the board is not valid.
        """
        if not isinstance(document, Mapping):
            raise BoardError(f"the board is {str(document)[:40]!r}: an object with kind, columns, rows ... is needed")
        needed = {"kind", "columns", "rows", "pitch_m"}
        if document.get("kind") == "charuco":
            needed |= {"marker_m", "dictionary"}
        if missing := sorted(needed - set(document)):
            raise BoardError(f"the board has no {', '.join(missing)}: add it")
        if unknown := sorted(str(key)[:40] for key in set(document) - needed):
            raise BoardError(
                f"the board has unknown members ({', '.join(unknown)}): use only {', '.join(sorted(needed))}"
            )
        return cls(**{str(key): value for key, value in document.items()})


def _check_length(name: str, length_m: object) -> None:
    if isinstance(length_m, bool) or not isinstance(length_m, int | float) or not abs(length_m) <= sys.float_info.max:
        raise BoardError(f"{name} is {str(length_m)[:40]!r}: a number of metres is needed")
    if not MIN_PITCH_M <= length_m <= MAX_PITCH_M:
        hint = "check the units"
        if length_m >= 1:
            hint = f"metres are needed, and {length_m:g} looks like millimetres"
        raise BoardError(f"{name} is {length_m:g} m, outside the range {MIN_PITCH_M:g} to {MAX_PITCH_M:g} m: {hint}")


def board_with_defaults(fields: dict[str, Any]) -> Board:
    """Create a board from some of its fields. The other fields keep their defaults.

    Args:
        fields: Values of `Board` fields by field name. If `pitch_m` is given without `marker_m`, the default marker
            side is scaled with the pitch.

    Raises:
        BoardError: The board is not valid.
    """
    if "pitch_m" in fields and "marker_m" not in fields:
        fields = fields | {"marker_m": fields["pitch_m"] * Board.marker_m / Board.pitch_m}
    return Board(**fields)
