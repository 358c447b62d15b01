"""The printed board: true to scale, with its margin and description, and the same bytes each time."""

import re
import zlib
from pathlib import Path

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.patches import Patch
from matplotlib.transforms import Bbox
from numpy.typing import NDArray

from calibration.target.board import Board, BoardError
from calibration.target.detection import detect_board
from calibration.target.pdf import PAPER_SIZES_MM, draw_board_page, write_board_pdf

pytestmark = pytest.mark.slow

MM_PER_POINT = 25.4 / 72
DPI = 150
BOARDS = [
    Board(),
    Board("charuco", 9, 5, 0.029, 0.022),
    Board("checkerboard", 10, 7, 0.023),
    Board("circles", 10, 10, 0.017),
    Board("charuco", 5, 7, 0.012, 0.009),
]


def pages_text(pdf: bytes) -> str:
    """Return the drawing commands of the page."""
    for stream in re.findall(rb"stream\r?\n(.*?)\r?\nendstream", pdf, re.DOTALL):
        try:
            text = zlib.decompress(stream).decode("latin-1")
        except zlib.error:
            continue
        if " Tf" in text:
            return text
    raise AssertionError("no page in the PDF")


def raster(board: Board, paper: str) -> NDArray[np.uint8]:
    """Return the page as printed at DPI dots per inch, (H, W) grey."""
    page = draw_board_page(board, paper)
    page.set_dpi(DPI)
    canvas = FigureCanvasAgg(page)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[:, :, 0].copy()


@pytest.mark.parametrize("paper", PAPER_SIZES_MM)
def test_the_page_has_the_size_of_the_paper(paper: str, tmp_path: Path):
    write_board_pdf(Board(), tmp_path / "board.pdf", paper)
    content = (tmp_path / "board.pdf").read_bytes()
    box = re.search(rb"/MediaBox \[ 0 0 ([\d.]+) ([\d.]+) \]", content)
    assert box is not None
    size = [float(points) * MM_PER_POINT for points in box.groups()]
    assert size == pytest.approx(PAPER_SIZES_MM[paper], abs=0.01)  # landscape, because the board is wider than high
    assert content.count(b"/Type /Page ") == 1


@pytest.mark.parametrize("board", BOARDS, ids=str)
def test_the_scale_line_is_100_mm_long(board: Board, tmp_path: Path):
    write_board_pdf(board, tmp_path / "board.pdf")
    text = pages_text((tmp_path / "board.pdf").read_bytes())
    number = r"(-?[\d.]+)"
    strokes = re.findall(rf"{number} {number} m\s+{number} {number} l\s+S", text)
    lengths = [np.hypot(float(x1) - float(x0), float(y1) - float(y0)) for x0, y0, x1, y1 in strokes]
    # The line and the two ticks at its ends.
    assert len(lengths) == 3
    assert max(lengths) * MM_PER_POINT == pytest.approx(100.0, abs=0.01)
    line, *ticks = sorted((np.array(stroke, dtype=float).reshape(2, 2) for stroke in strokes), key=_length)[::-1]
    ends = sorted(tuple(np.round(tick.mean(axis=0), 3)) for tick in ticks)
    np.testing.assert_allclose(ends, sorted(tuple(np.round(end, 3)) for end in line), atol=0.02)


def _length(stroke: NDArray[np.float64]) -> float:
    return float(np.linalg.norm(stroke[1] - stroke[0]))


@pytest.mark.parametrize("board", BOARDS, ids=str)
def test_the_board_on_the_page_is_true_to_scale(board: Board):
    sighting = detect_board(raster(board, "a4"), board)
    assert len(sighting.ids) == len(board.points)
    on_page = sighting.pixels * 25.4 / DPI
    wanted = board.points[:, :2] * 1e3
    # The board is only shifted: not rotated, mirrored or stretched.
    off = (on_page - on_page.mean(axis=0)) - (wanted - wanted.mean(axis=0))
    assert np.abs(off).max() <= 0.1


@pytest.mark.parametrize("board", BOARDS, ids=str)
@pytest.mark.parametrize("paper", PAPER_SIZES_MM)
def test_the_margin_is_white_and_the_text_is_on_the_page(board: Board, paper: str):
    image = raster(board, paper)
    edge = int(5.0 / 25.4 * DPI)
    inside = image[edge:-edge, edge:-edge].copy()
    image[edge:-edge, edge:-edge] = 255
    assert (image == 255).all()
    assert (inside < 128).any()


@pytest.mark.parametrize("board", [*BOARDS, Board("charuco", 3, 5, 0.009, 0.007)], ids=str)
def test_the_text_does_not_overlap_the_board(board: Board):
    page = draw_board_page(board)
    renderer = FigureCanvasAgg(page).get_renderer()
    boxes = [text.get_window_extent(renderer) for text in page.texts]
    whole = page.bbox
    board_box = Bbox.union(
        [shape.get_window_extent(renderer) for shape in page.findobj(Patch) if shape is not page.patch]
    )
    for box in boxes:
        assert whole.x0 < box.x0 < box.x1 < whole.x1
        assert whole.y0 < box.y0 < box.y1 < whole.y1
        assert not box.overlaps(board_box)
    words = " ".join(text.get_text() for text in page.texts)
    assert f"{board.columns} x {board.rows}" in words
    assert f"{board.pitch_m * 1e3:g} mm" in words
    assert "100 %" in words
    assert (board.dictionary in words) == (board.kind == "charuco")


def test_the_same_board_gives_the_same_bytes(tmp_path: Path):
    write_board_pdf(Board(), str(tmp_path / "1.pdf"))  # a path may be a string
    write_board_pdf(Board(), tmp_path / "2.pdf")
    content = (tmp_path / "1.pdf").read_bytes()
    assert content == (tmp_path / "2.pdf").read_bytes()
    assert b"CreationDate" not in content


@pytest.mark.parametrize(
    ("board", "paper", "words"),
    [
        (Board(pitch_m=0.03, marker_m=0.023), "a4", "270 x 210 mm, .* use a3 paper or a pitch of at most 28 mm"),
        (Board(pitch_m=0.06, marker_m=0.046), "a3", "a3 paper .*: use a pitch of at most 39.5 mm"),
        (Board("checkerboard", 100, 100, 0.005), "a4", "use a pitch of at most 1.5 mm"),
        (Board("circles", 40, 30, 0.009), "a4", "use a3 paper or a pitch of at most 6.5 mm"),
        (Board(), "a5", "paper size 'a5' is unknown: use one of a4, letter, a3"),
    ],
    ids=str,
)
def test_a_board_that_does_not_fit_is_rejected_with_an_action(board: Board, paper: str, words: str, tmp_path: Path):
    with pytest.raises(BoardError, match=words):
        write_board_pdf(board, tmp_path / "board.pdf", paper)
    assert not (tmp_path / "board.pdf").exists()
    pitch = re.search(r"at most ([\d.]+) mm", words)
    if pitch is not None:
        smaller = float(pitch[1]) / 1e3
        fitting = Board(board.kind, board.columns, board.rows, smaller, board.marker_m / board.pitch_m * smaller)
        write_board_pdf(fitting, tmp_path / "board.pdf", paper)
