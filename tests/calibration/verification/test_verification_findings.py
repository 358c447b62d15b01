"""What the views that were held out say against a calibration that was just solved."""

import math

import pytest

from calibration.verification.verification import Verification, VerifiedView, verification_findings


def seen(passed: bool, board_moved_m: float | None = None, worst_m: float = 0.004) -> Verification:
    view = VerifiedView("16", worst_m, 0.01, 0.0005, 0.0002)
    turned = None if board_moved_m is None else 0.01
    return Verification(
        (view,), worst_m, 0.0005, 0.01, 0.0002, board_moved_m, turned, passed, "the board appears elsewhere"
    )


def test_one_that_holds_has_nothing_against_it() -> None:
    assert verification_findings(seen(True)) == ()


@pytest.mark.parametrize("verification", [seen(False), seen(True, board_moved_m=0.004)])
def test_a_board_elsewhere_refuses_it_since_nobody_has_moved_it(verification: Verification) -> None:
    (finding,) = verification_findings(verification)
    assert (finding.code, finding.blocking) == ("verification-failed", True)
    assert "4.0 mm and 0.57 degrees off, and about 0.5 mm and 0.01 degrees is expected" in finding.message


def test_a_board_that_is_only_turned_is_told_by_its_turn() -> None:
    (finding,) = verification_findings(seen(False, worst_m=0.0001))
    assert "0.1 mm and 0.57 degrees off, and about 0.5 mm and 0.01 degrees is expected" in finding.message


def test_without_views_it_is_a_warning() -> None:
    nothing = Verification((), math.nan, math.nan, math.nan, math.nan, None, None, False, "there is no view")
    (finding,) = verification_findings(nothing)
    assert (finding.code, finding.blocking) == ("not-verified", False)
    assert finding.message.startswith("there is no view")
