"""What the views that were held out say against a calibration that was just solved."""

import pytest

from calibration.verification import Verification, VerifiedView
from calibration.verified import verification_findings


def seen(passed: bool, board_moved_m: float | None = None) -> Verification:
    view = VerifiedView("16", 0.004, 0.01, 0.0005)
    return Verification((view,), 0.004, 0.0005, board_moved_m, passed, "the board appears elsewhere")


def test_one_that_holds_has_nothing_against_it() -> None:
    assert verification_findings(seen(True)) == ()


@pytest.mark.parametrize("verification", [seen(False), seen(True, board_moved_m=0.004)])
def test_a_board_elsewhere_refuses_it_since_nobody_has_moved_it(verification: Verification) -> None:
    (finding,) = verification_findings(verification)
    assert (finding.code, finding.refuses) == ("verification-failed", True)
    assert "4.0 mm off, where about 0.5 mm is expected" in finding.words


def test_without_views_it_is_a_warning() -> None:
    (finding,) = verification_findings(Verification((), float("nan"), float("nan"), None, False, "there is no view"))
    assert (finding.code, finding.refuses) == ("not-verified", False)
    assert finding.words.startswith("there is no view")
