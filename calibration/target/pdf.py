"""Write a printable PDF of a board, true to scale, with a check line for the scale and a description of the board."""

import io
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from calibration.target.board import Board, BoardError
from calibration.target.rendering import board_shapes

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from matplotlib.transforms import Transform

PAPER_SIZES_MM = {"a4": (297.0, 210.0), "letter": (279.4, 215.9), "a3": (420.0, 297.0)}
"""Long and short side of each paper size, mm."""
EDGE_MM = 6.0
"""Margin that printers leave white at each edge of the paper, mm."""
QUIET_ZONE_PITCHES = {"charuco": 0.25, "checkerboard": 0.5, "circles": 0.25}
"""White margin that detection needs around the board, in pitches. OpenCV's checkerboard detector needs the widest
margin."""
STRIP_MM = 19.0
"""Width of the strip for the check line and the description, along one side of the paper, mm."""
STRIP_LENGTH_MM = 150.0
"""Length of the strip, mm. Every line of the description fits in it."""
LINE_MM = 100.0
"""Length of the check line, mm."""
TICK_MM = 4.0
"""Length of the ticks at the ends of the check line, mm."""
STROKE_MM = 0.25
"""Stroke width of the check line, mm."""
TEXT_PT = 8.0
"""Font size, points."""
LINE_SPACING = 1.35
"""Distance between lines of text, in font sizes."""
TEXT_GAP_MM = 2.0
"""Distance between the check line and its text, mm."""
PITCH_STEP_MM = 0.5
"""Step of the pitch that the message proposes if a board does not fit, mm."""
MM_PER_INCH = 25.4
"""Millimetres per inch."""
POINTS_PER_INCH = 72
"""Typographic points per inch."""


@dataclass(frozen=True)
class _Layout:
    """Positions on the paper, mm from its top left corner."""

    width: float
    """Width of the paper, mm."""
    height: float
    """Height of the paper, mm."""
    left: float
    """Left edge of the board, mm."""
    top: float
    """Top edge of the board, mm."""
    is_strip_below: bool
    """Whether the strip with the check line and the description is below the board. If False, the strip is to the right
    of the board, rotated by a quarter turn."""
    spare: float
    """Smaller of the left and top margins, minus the required margin, mm. Negative if the board does not fit."""


def write_board_pdf(board: Board, path: str | os.PathLike[str], paper: str = "a4") -> None:
    """Write a board as a PDF with one page. The same board and paper give the same bytes.

    Args:
        board: The board.
        path: The PDF file. An existing file is overwritten.
        paper: Paper size, "a4", "letter" or "a3". The page is landscape or portrait, whichever has the wider margin.

    Raises:
        BoardError: The paper size is unknown, or the board does not fit on it.
        OSError: The file cannot be written.
    """
    from matplotlib.backends.backend_pdf import FigureCanvasPdf

    page = draw_board_page(board, paper)
    content = io.BytesIO()
    # No date, so that the same board gives the same bytes. `savefig` would crop the page with some user settings.
    metadata = {"Title": f"Calibration board: {board}", "Creator": None, "Producer": None, "CreationDate": None}
    FigureCanvasPdf(page).print_pdf(content, metadata=metadata)
    Path(path).write_bytes(content.getvalue())


def draw_board_page(board: Board, paper: str = "a4") -> "Figure":
    """Draw the page with the board, the check line and the description.

    Args:
        board: The board.
        paper: Paper size, "a4", "letter" or "a3".

    Returns:
        A matplotlib figure with the size of the paper.

    Raises:
        BoardError: The paper size is unknown, or the board does not fit on it.
    """
    from matplotlib.figure import Figure
    from matplotlib.transforms import Affine2D

    layout = _choose_layout(board, paper)
    page = Figure(figsize=(layout.width / MM_PER_INCH, layout.height / MM_PER_INCH), facecolor="white")
    # Convert millimetres with y down to matplotlib's inches with y up.
    to_page = Affine2D().scale(1.0, -1.0).translate(0.0, layout.height).scale(1 / MM_PER_INCH) + page.dpi_scale_trans
    _draw_board(page, board, layout, to_page)
    if layout.is_strip_below:
        rotation_deg = 0.0
        start = min(layout.left, layout.width - EDGE_MM - STRIP_LENGTH_MM)
        along = Affine2D().translate(start, layout.height - EDGE_MM - STRIP_MM)
    else:
        rotation_deg = -90.0
        start = min(layout.top, layout.height - EDGE_MM - STRIP_LENGTH_MM)
        along = Affine2D().rotate_deg(90.0).translate(layout.width - EDGE_MM, start)
    _draw_strip(page, board, along + to_page, rotation_deg)
    return page


def _choose_layout(board: Board, paper: str) -> _Layout:
    """Return the layout. If the board does not fit, raise BoardError with changes that make it fit."""
    if paper not in PAPER_SIZES_MM:
        raise BoardError(f"the paper size {paper[:40]!r} is unknown: use one of {', '.join(PAPER_SIZES_MM)}")
    layout = _fit_layout(board, paper)
    if layout is not None:
        return layout
    remedies = [f"{other} paper" for other in PAPER_SIZES_MM if _fit_layout(board, other)]
    max_pitch_mm = _find_max_pitch_mm(board, paper)
    if max_pitch_mm is not None:
        remedies.append(f"a pitch of at most {max_pitch_mm:g} mm")
    advice = " or ".join(remedies) or "fewer columns or rows"
    width_m, height_m = board.size_m
    raise BoardError(
        f"the board ({board}) is {1e3 * width_m:g} x {1e3 * height_m:g} mm, and does not fit on {paper} paper with its "
        f"margin and the check line: use {advice}"
    )


def _fit_layout(board: Board, paper: str) -> _Layout | None:
    """Return the layout with the widest margin, or None if the board does not fit on the paper."""
    long, short = PAPER_SIZES_MM[paper]
    board_width_m, board_height_m = board.size_m
    quiet_zone = max(QUIET_ZONE_PITCHES[board.kind] * board.pitch_m * 1e3, EDGE_MM)
    layouts = []
    for width, height in ((long, short), (short, long)):
        for is_strip_below in (True, False):
            free_width = width - 1e3 * board_width_m
            free_height = height - 1e3 * board_height_m
            if is_strip_below:
                free_height -= EDGE_MM + STRIP_MM
            else:
                free_width -= EDGE_MM + STRIP_MM
            left = free_width / 2
            top = free_height / 2
            layouts.append(_Layout(width, height, left, top, is_strip_below, min(left, top) - quiet_zone))
    best = max(layouts, key=lambda layout: layout.spare)
    if best.spare < 0:
        return None
    return best


def _find_max_pitch_mm(board: Board, paper: str) -> float | None:
    """Return the largest multiple of `PITCH_STEP_MM` for which the board fits, mm, or None if no pitch fits."""
    for steps in range(int(board.pitch_m * 1e3 / PITCH_STEP_MM), 0, -1):
        pitch_m = steps * PITCH_STEP_MM / 1e3
        try:
            smaller = replace(board, pitch_m=pitch_m, marker_m=board.marker_m * pitch_m / board.pitch_m)
        except BoardError:
            return None
        if _fit_layout(smaller, paper) is not None:
            return steps * PITCH_STEP_MM
    return None


def _draw_board(page: "Figure", board: Board, layout: _Layout, to_page: "Transform") -> None:
    from matplotlib.patches import Circle, PathPatch
    from matplotlib.path import Path as Outline

    shapes = board_shapes(board)
    start = np.array([layout.left, layout.top]) - 1e3 * np.array(board.print_corner)
    if len(shapes.rectangles):
        x0, y0, x1, y1 = (1e3 * shapes.rectangles + np.tile(start, 2)).T
        corners = np.stack([x0, y0, x1, y0, x1, y1, x0, y1, x0, y0], axis=1).reshape(-1, 2)
        codes = [Outline.MOVETO, Outline.LINETO, Outline.LINETO, Outline.LINETO, Outline.CLOSEPOLY]
        # Draw all rectangles as one path. Viewers may show white hairlines between separate paths.
        outline = Outline(corners, np.tile(codes, len(shapes.rectangles)))
        page.add_artist(PathPatch(outline, facecolor="black", edgecolor="none", transform=to_page, snap=False))
    for x, y, radius in shapes.discs * 1e3 + np.append(start, 0.0):
        page.add_artist(Circle((x, y), radius, facecolor="black", edgecolor="none", transform=to_page, snap=False))


def _draw_strip(page: "Figure", board: Board, to_page: "Transform", rotation_deg: float) -> None:
    """Draw the check line and the description.

    Args:
        page: The figure.
        board: The board to describe.
        to_page: Transform from the strip to the page. Strip coordinates are mm, x along the strip and y across it.
        rotation_deg: Rotation of the text, degrees.
    """
    import matplotlib
    from matplotlib.font_manager import FontProperties
    from matplotlib.lines import Line2D

    strokes = [
        ([0.0, LINE_MM], [TICK_MM / 2, TICK_MM / 2]),
        ([0.0, 0.0], [0.0, TICK_MM]),
        ([LINE_MM, LINE_MM], [0.0, TICK_MM]),
    ]
    stroke_pt = STROKE_MM / MM_PER_INCH * POINTS_PER_INCH
    for x, y in strokes:
        line = Line2D(x, y, color="black", linewidth=stroke_pt, transform=to_page, snap=False)
        line.set_solid_capstyle("butt")
        page.add_artist(line)
    # Matplotlib's own font is always available, unlike the font in the user settings.
    font = FontProperties(fname=Path(matplotlib.get_data_path()) / "fonts/ttf/DejaVuSans.ttf", size=TEXT_PT)
    line_mm = LINE_SPACING * TEXT_PT / POINTS_PER_INCH * MM_PER_INCH
    texts = [(LINE_MM + TEXT_GAP_MM, TICK_MM / 2 + line_mm / 4, "100 mm: measure it")]
    texts += [(0.0, TICK_MM + line_mm * (1 + number), text) for number, text in enumerate(_describe_board(board))]
    to_share_of_page = to_page + page.transFigure.inverted()
    for x, y, text in texts:
        across, up = (float(share) for share in to_share_of_page.transform((x, y)))
        page.text(
            across,
            up,
            text,
            fontproperties=font,
            usetex=False,
            rotation=rotation_deg,
            rotation_mode="anchor",
            horizontalalignment="left",
            verticalalignment="baseline",
        )


def _describe_board(board: Board) -> list[str]:
    """Return the text lines below the check line: the board and two instructions."""
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
        "Print at 100 % (actual size). If the line is not 100 mm long, enter the pitch that you measure.",
        "Glue it flat on a stiff, dull plate and leave the white margin free.",
    ]
