"""Outputs that differ from the shown ones are found, and accepted deviations are not."""

import pytest

from tests.docs.outputs import LIVE, LOOSE, SEEDED, WORDS, Tolerance, differences, shown_after


@pytest.mark.parametrize(
    ("shown", "printed", "tolerance"),
    [
        ("chain 0: 0.398 m, 135 points", "chain 0: 0.399 m, 135 points", SEEDED),
        ("a piece at (-110, 7, 14) mm", "a piece at (-111, 7, 13) mm", SEEDED),
        ("[ 2.676 -1.802]", "[  2.6757  -1.802 ]", SEEDED),
        ("done in 0.5 s", "done in 12.25 s", SEEDED),
        ("135 points, gap 0.0085 m", "132 points, gap 0.0087 m", LIVE),
        ("mean error 0.25 mm", "mean error 0.31 mm", LOOSE),
        ("at most 0.8 mm off", "at most 17.0 mm off", WORDS),
    ],
)
def test_small_deviations_are_accepted(shown: str, printed: str, tolerance: Tolerance) -> None:
    assert differences(f"{shown}\n", f"\n{printed}\n", tolerance) == []


@pytest.mark.parametrize(
    ("shown", "printed", "tolerance"),
    [
        ("chain 0: 0.398 m, 135 points", "chain 0: 0.398 m, 134 points", SEEDED),
        ("chain 0: 0.398 m", "chain 0: 0.400 m", SEEDED),
        ("crossing at 0.398 m", "crossing at -0.398 m", SEEDED),
        ("verdict: accept", "verdict: review", SEEDED),
        ("verdict: accept", "verdict: accept\nnote", SEEDED),
        ("a piece at (-110, 7, 14) mm", "a piece at (-110, 9, 14) mm", SEEDED),
        ("grasp 0 of chain 0 at 0.277 m", "grasp 1 of chain 0 at 0.277 m", LIVE),
        ("grasp 0 of chain 0 at 0.277 m", "grasp 0 of chain 0 at 0.342 m", LIVE),
        ("by a simulated ur5e", "by a simulated ur10e", LOOSE),
        ("00_pose00: at most 0.8 mm off", "01_pose00: at most 0.8 mm off", WORDS),
    ],
)
def test_differences_are_found(shown: str, printed: str, tolerance: Tolerance) -> None:
    assert len(differences(shown, printed, tolerance)) == 1


def test_the_output_after_a_command_is_found() -> None:
    assert "Live scan " in shown_after("README.md", "make demo")
