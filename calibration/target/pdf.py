"""A board as a PDF to print, true to scale, with a line to check the scale by and what the board is in words."""

import io
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from calibration.target.board import Board, BoardError
from calibration.target.rendering import board_shapes

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from matplotlib.transforms import Transform

PAPERS_MM = {"a4": (297.0, 210.0), "letter": (279.4, 215.9), "a3": (420.0, 297.0)}
"""Long and short side."""
EDGE_MM = 6.0
"""Printers leave so much at the paper's edges white."""
QUIET_PITCHES = {"charuco": 0.25, "checkerboard": 0.5, "circles": 0.25}
"""White that detection needs around the board; OpenCV's checkerboard detector wants most."""
STRIP_MM = 19.0
"""For the check line and the words, along one side of the paper."""
STRIP_LENGTH_MM = 150.0
"""No line of words is longer."""
LINE_MM = 100.0
TICK_MM = 4.0
INK_MM = 0.25
"""Width of the check line."""
TEXT_PT = 8.0
STEP_MM = 0.5
"""Of the pitch that is proposed where a board does not fit."""
MM_PER_INCH = 25.4


@dataclass(frozen=True)
class _Layout:
    """Where everything is on the paper, mm from its top left corner."""

    width: float
    height: float
    left: float
    """Of the board."""
    top: float
    strip_below: bool
    """The check line and the words are below the board; else to its right, turned by a quarter."""
    spare: float
    """White left over on the narrower side."""


def write_board_pdf(board: Board, path: Path, paper: str = "a4") -> None:
    """Writes the board as a PDF with one page: `paper` is "a4", "letter" or "a3", upright or across as the board fits.

    The same board gives the same bytes.

    Raises:
        BoardError: there is no such paper, or the board does not fit on it.
        OSError: the file cannot be written.
    """
    from matplotlib.backends.backend_pdf import FigureCanvasPdf

    page = board_page(board, paper)
    content = io.BytesIO()
    # No date, so that the same board is the same file. Not `savefig`, which would crop the page where a user's settings
    # ask for that.
    metadata = {"Title": f"Calibration board: {board}", "Creator": None, "Producer": None, "CreationDate": None}
    FigureCanvasPdf(page).print_pdf(content, metadata=metadata)
    path.write_bytes(content.getvalue())


def board_page(board: Board, paper: str = "a4") -> "Figure":
    """The page as a matplotlib figure, of the paper's size.

    Raises:
        BoardError: there is no such paper, or the board does not fit on it.
    """
    from matplotlib.figure import Figure
    from matplotlib.transforms import Affine2D

    layout = _layout(board, paper)
    page = Figure(figsize=(layout.width / MM_PER_INCH, layout.height / MM_PER_INCH), facecolor="white")
    # From millimetres, y downwards, to matplotlib's inches, y upwards.
    to_page = Affine2D().scale(1.0, -1.0).translate(0.0, layout.height).scale(1 / MM_PER_INCH) + page.dpi_scale_trans
    _draw_board(page, board, layout, to_page)
    if layout.strip_below:
        start = min(layout.left, layout.width - EDGE_MM - STRIP_LENGTH_MM)
        along = Affine2D().translate(start, layout.height - EDGE_MM - STRIP_MM)
    else:
        start = min(layout.top, layout.height - EDGE_MM - STRIP_LENGTH_MM)
        along = Affine2D().rotate_deg(90.0).translate(layout.width - EDGE_MM, start)
    _draw_strip(page, board, along + to_page, 0.0 if layout.strip_below else -90.0)
    return page


def _layout(board: Board, paper: str) -> _Layout:
    if paper not in PAPERS_MM:
        raise BoardError(f"there is no paper {paper[:40]!r} here: one of {', '.join(PAPERS_MM)} is needed")
    layout = _fitted(board, paper)
    if layout is not None:
        return layout
    ways = [f"{other} paper" for other in PAPERS_MM if _fitted(board, other)]
    smaller = _largest_pitch_mm(board, paper)
    if smaller is not None:
        ways.append(f"a pitch of at most {smaller:g} mm")
    width, height = (1e3 * side for side in board.size_m)
    raise BoardError(
        f"the board ({board}) is {width:g} x {height:g} mm, and with its margin and the check line does not fit on "
        f"{paper} paper: take {' or '.join(ways) if ways else 'fewer columns or rows'}"
    )


def _fitted(board: Board, paper: str) -> _Layout | None:
    """The layout with the widest margin; None: none has margin enough."""
    long, short = PAPERS_MM[paper]
    board_width, board_height = (1e3 * side for side in board.size_m)
    quiet = max(QUIET_PITCHES[board.kind] * board.pitch_m * 1e3, EDGE_MM)
    layouts = []
    for width, height in ((long, short), (short, long)):
        for strip_below in (True, False):
            strip = EDGE_MM + STRIP_MM
            left = (width - board_width - (0.0 if strip_below else strip)) / 2
            top = (height - board_height - (strip if strip_below else 0.0)) / 2
            layouts.append(_Layout(width, height, left, top, strip_below, min(left, top) - quiet))
    best = max(layouts, key=lambda layout: layout.spare)
    return best if best.spare >= 0 else None


def _largest_pitch_mm(board: Board, paper: str) -> float | None:
    """The largest pitch of such a board that fits, in steps that are easily measured."""
    for steps in range(int(board.pitch_m * 1e3 / STEP_MM), 0, -1):
        pitch_m = steps * STEP_MM / 1e3
        try:
            smaller = replace(board, pitch_m=pitch_m, marker_m=board.marker_m * pitch_m / board.pitch_m)
        except BoardError:
            return None
        if _fitted(smaller, paper) is not None:
            return steps * STEP_MM
    return None


def _draw_board(page: "Figure", board: Board, layout: _Layout, to_page: "Transform") -> None:
    from matplotlib.patches import Circle, PathPatch
    from matplotlib.path import Path as Outline

    shapes = board_shapes(board)
    start = np.array([layout.left, layout.top]) - 1e3 * np.array(board.corner_of_print)
    if len(shapes.rectangles):
        x0, y0, x1, y1 = (1e3 * shapes.rectangles + np.tile(start, 2)).T
        corners = np.stack([x0, y0, x1, y0, x1, y1, x0, y1, x0, y0], axis=1).reshape(-1, 2)
        codes = [Outline.MOVETO, Outline.LINETO, Outline.LINETO, Outline.LINETO, Outline.CLOSEPOLY]
        # One path for all: between rectangles that are drawn one by one a viewer may leave white hairlines.
        outline = Outline(corners, np.tile(codes, len(shapes.rectangles)))
        page.add_artist(PathPatch(outline, facecolor="black", edgecolor="none", transform=to_page, snap=False))
    for x, y, radius in shapes.discs * 1e3 + np.append(start, 0.0):
        page.add_artist(Circle((x, y), radius, facecolor="black", edgecolor="none", transform=to_page, snap=False))


def _draw_strip(page: "Figure", board: Board, to_page: "Transform", turn: float) -> None:
    """The check line and the words in a strip whose coordinates are mm along and across it."""
    import matplotlib
    from matplotlib.font_manager import FontProperties
    from matplotlib.lines import Line2D

    ends = np.array([0.0, LINE_MM])
    strokes = [(ends, np.full(2, TICK_MM / 2)), *((np.full(2, end), np.array([0.0, TICK_MM])) for end in ends)]
    for x, y in strokes:
        line = Line2D(x, y, color="black", linewidth=INK_MM / MM_PER_INCH * 72, transform=to_page, snap=False)
        line.set_solid_capstyle("butt")
        page.add_artist(line)
    # The font that comes with matplotlib, whatever a user's settings say: it is there.
    font = FontProperties(fname=Path(matplotlib.get_data_path()) / "fonts/ttf/DejaVuSans.ttf", size=TEXT_PT)
    line_mm = 1.35 * TEXT_PT / 72 * MM_PER_INCH
    words = [(LINE_MM + 2.0, TICK_MM / 2 + line_mm / 4, "100 mm: measure it")]
    words += [(0.0, TICK_MM + line_mm * (1 + number), text) for number, text in enumerate(_words(board))]
    to_share_of_page = to_page + page.transFigure.inverted()
    for x, y, text in words:
        across, up = (float(share) for share in to_share_of_page.transform((x, y)))
        page.text(
            across,
            up,
            text,
            fontproperties=font,
            usetex=False,
            rotation=turn,
            rotation_mode="anchor",
            horizontalalignment="left",
            verticalalignment="baseline",
        )


def _words(board: Board) -> list[str]:
    pitch = f"{1e3 * board.pitch_m:g} mm"
    match board.kind:
        case "charuco":
            kind = f"ChArUco board: {board.columns} x {board.rows} squares of {pitch}, markers of "
            kind += f"{1e3 * board.marker_m:g} mm, {board.dictionary}"
        case "checkerboard":
            kind = f"Checkerboard: {board.columns} x {board.rows} squares of {pitch}"
        case "circles":
            kind = f"Circle grid: {board.columns} x {board.rows} dots, {pitch} from centre to centre"
    return [
        kind + ".",
        "Print at 100 % (actual size). If the line is not 100 mm long, tell the pitch that you measure.",
        "Glue it flat on a stiff, dull plate and leave the white margin free.",
    ]
