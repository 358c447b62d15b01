"""The note on errors of stereo matching that were corrected, and the doubt about a radius measured in such depth."""

from dataclasses import replace

import numpy as np
import pytest

from recognition.assembly.stereo_findings import MIN_SHIFT_RADII, stereo_findings, uncertain_radius_findings
from recognition.depth_correction.drawn_strings import DrawnViews
from recognition.depth_correction.pixel_locking import HARMONICS, PixelLocking
from recognition.model.chains import Chain
from recognition.refinement.refinement import Refinement

R = 0.004
PERIOD_PER_M = 0.03
UNCHANGED = Refinement([], np.zeros(0, dtype=np.int64), 0.0002)


def locking(error_px: float) -> PixelLocking:
    """Return pixel locking with one harmonic, measured at 0.4 m."""
    coefficients = np.zeros(2 * len(HARMONICS))
    coefficients[0] = error_px * PERIOD_PER_M
    return PixelLocking(PERIOD_PER_M, coefficients, depth_m=0.4)


def test_depth_without_corrections_has_no_note() -> None:
    assert stereo_findings(None, 1.0, None, None, R) == ()
    assert stereo_findings(None, 1.0, None, UNCHANGED, R) == ()


def test_small_shifts_of_heights_and_ends_have_no_note() -> None:
    small_m = 0.9 * MIN_SHIFT_RADII * R
    for sign in (-1, 1):
        refinement = replace(UNCHANGED, lost_m=sign * small_m, border_offset_m=sign * small_m)
        assert stereo_findings(None, 1.0, None, refinement, R) == ()


def test_one_note_lists_all_corrections_and_has_the_largest_as_its_value() -> None:
    refinement = replace(UNCHANGED, lost_m=0.0006, border_offset_m=0.0011)
    (note,) = stereo_findings(locking(0.1), 0.78, None, refinement, R)
    assert (note.code, note.severity, note.limit) == ("stereo-depth-corrected", "note", None)
    # 0.1 disparities of 0.03 per metre at 0.4 m are 0.48 mm; a loss of 22 % of 8 mm is 1.76 mm.
    assert note.message == (
        "errors of stereo matching were corrected: stripes of up to 0.5 mm on the table, at a depth of 0.40 m, were "
        "subtracted; heights of strings, measured at 78 %, were restored; resting strings were raised by 0.6 mm; "
        "ends were moved inwards by 1.1 mm"
    )
    assert note.value == pytest.approx(0.00176)


def test_a_note_lists_only_what_applies_and_its_direction() -> None:
    (lowered,) = stereo_findings(None, 1.0, None, replace(UNCHANGED, lost_m=-0.0003), R)
    assert lowered.message.endswith("corrected: resting strings were lowered by 0.3 mm")
    assert lowered.value == pytest.approx(0.0003)
    (outwards,) = stereo_findings(None, 1.0, None, replace(UNCHANGED, border_offset_m=-0.0004), R)
    assert outwards.message.endswith("corrected: ends were moved outwards by 0.4 mm")
    (without_strings,) = stereo_findings(locking(0.2), 1.0, None, None, R)
    assert without_strings.value == pytest.approx(0.00096, rel=0.01)


def test_drawn_strings_are_listed_instead_of_a_compression() -> None:
    drawn = DrawnViews([], compression=0.7, lost_m=0.0021)
    (note,) = stereo_findings(None, 0.7, drawn, None, R)
    assert note.message == (
        "errors of stereo matching were corrected: strings were drawn as tubes along their bands in the image, as all "
        "views are from one viewpoint, where their heights are uneven, in places 2.1 mm too low"
    )
    assert note.value == pytest.approx(0.0021)


def test_a_radius_from_matched_depth_is_a_doubt_on_all_chains() -> None:
    points = np.linspace((0.0, 0.0, R), (0.02, 0.0, R), 5)
    chain = Chain(0, False, R, points, np.zeros(5), np.ones(5, dtype=np.int64), ("free", "free"))
    chains = (chain, replace(chain, id=1))
    (doubt,) = uncertain_radius_findings(True, 0.0045, chains)
    assert (doubt.code, doubt.severity, doubt.chains) == ("radius-uncertain", "doubt", (0, 1))
    assert (doubt.value, doubt.limit) == (0.0045, None)
    assert doubt.message == (
        "the radius 4.5 mm was measured in depth of a stereo camera, where it can be wrong by a quarter or more: give "
        "the radius of the string"
    )
    assert uncertain_radius_findings(True, 0.0045, ()) == ()
    assert uncertain_radius_findings(False, 0.0045, chains) == ()
