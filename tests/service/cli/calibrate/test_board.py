"""`pointchain calibrate board` through the command line."""

from pathlib import Path

import pytest

from service.cli.main import main


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ((), "charuco"),
        (
            ("--kind", "checkerboard", "--columns", "8", "--rows", "6", "--pitch", "0.02"),
            "checkerboard 8 x 6, pitch 20",
        ),
        (
            ("--kind", "circles", "--columns", "7", "--rows", "7", "--pitch", "0.02", "--paper", "letter"),
            "circles 7 x 7",
        ),
        (("--pitch", "0.02"), "pitch 20 mm, markers 1"),
        (("--columns", "11", "--rows", "9", "--pitch", "0.03", "--paper", "a3"), "charuco 11 x 9, pitch 30 mm"),
    ],
)
def test_board_writes_a_pdf(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, options: tuple[str, ...], expected: str
) -> None:
    path = tmp_path / "board.pdf"
    assert main(["calibrate", "board", str(path), *options]) == 0
    out, err = capsys.readouterr()
    assert out == ""
    assert expected in err
    assert "print it at 100 %" in err
    assert path.read_bytes().startswith(b"%PDF")


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (("--rows", "6"), "an odd number is needed"),
        (("--pitch", "25"), "looks like millimetres"),
        (("--marker", "0.05"), "must be smaller"),
        (("--dictionary", "DICT_9X9_50"), "no dictionary"),
        (("--pitch", "0.1"), "paper"),
    ],
)
def test_an_impossible_board_is_rejected(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, options: tuple[str, ...], expected: str
) -> None:
    path = tmp_path / "board.pdf"
    assert main(["calibrate", "board", str(path), *options]) == 1
    assert expected in capsys.readouterr().err
    assert not path.exists()


def test_a_file_that_cannot_be_written_is_reported(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert main(["calibrate", "board", str(tmp_path / "none" / "board.pdf")]) == 1
    assert "cannot be written" in capsys.readouterr().err
