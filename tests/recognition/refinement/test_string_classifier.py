"""Classification of fitted strands by the surface beside them."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from recognition.model.findings import Finding
from recognition.parameters import ChainParameters
from recognition.preprocessing.support_surface import SupportSurface
from recognition.refinement.refinement import FittedStrand, Refinement
from recognition.refinement.string_classifier import (
    MAX_SQUARENESS,
    StringClassification,
    classify_strings,
    max_squareness,
)

R = 0.0042
PARAMETERS = ChainParameters.for_radius(R)


def fitted(points: np.ndarray) -> FittedStrand:
    n = len(points)
    return FittedStrand(
        points=points,
        closed=False,
        bridged=np.zeros(n, dtype=bool),
        support=np.full(n, 40.0),
        radius_m=R,
        measured_radius_m=R,
        roundness_error_m=0.0,
        squareness=0.0,
        squareness_sigma=0.05,
    )


def selected(
    surface: np.ndarray, *strands: FittedStrand, owned: float = 1.0
) -> tuple[list[FittedStrand], list[Finding]]:
    """Return the strings and the findings of a classification without doubts."""
    found = classified(surface, *strands, owned=owned)
    assert {finding.severity for finding in found.findings} <= {"note"}
    return list(found.strings), list(found.findings)


def assert_excluded(findings: Sequence[Finding], code: str, length_m: float, point: tuple[float, float, float]) -> None:
    """Check that the only finding is on an excluded piece with this length and this middle, both exact."""
    (found,) = findings
    assert (found.code, found.chains) == (code, ())
    assert found.value == pytest.approx(length_m, abs=1e-9)
    assert found.point_m == pytest.approx(point, abs=1e-9)
    position = ", ".join(f"{1000 * value:.0f}" for value in point)
    assert found.message.startswith(f"excluded a piece of {1000 * length_m:.0f} mm at ({position}) mm")


def assert_not_round(kept: Sequence[FittedStrand], findings: Sequence[Finding]) -> None:
    """Check that the string of 100 mm along x was excluded because it is not round."""
    assert list(kept) == []
    assert_excluded(findings, "piece-not-round", 0.1, (0.05, 0.0, R))


def classified(surface: np.ndarray, *strands: FittedStrand, owned: float = 1.0) -> StringClassification:
    """Classify strands. The share `owned` of the surface nearest to each lies on its tube, and the rest on none."""
    distance = np.array([np.linalg.norm(surface[:, None] - s.points, axis=2).min(axis=1) for s in strands])
    on = np.arange(len(surface)) % 100 < 100 * owned
    return classify_strings(
        Refinement(list(strands), np.where(on, distance.argmin(axis=0), -1), 0.0002), surface, PARAMETERS
    )


def with_face(surface: np.ndarray, line: np.ndarray) -> np.ndarray:
    """Return the surface with a flat face of 10 mm beside the line, which begins two radii from it."""
    offsets = np.arange(2.1 * R, 2.1 * R + 0.01, 0.001)
    face = [point + (0, offset, 0) for point in line for offset in offsets]
    return np.vstack([surface, face])


def test_a_string_has_its_surface_to_itself(seen: Callable, straight: Callable) -> None:
    line = straight((0, 0, R), (0.1, 0, R), 0.003)
    surface, _ = seen([line])
    (kept,), findings = selected(surface, fitted(line))
    np.testing.assert_array_equal(kept.points, line)
    assert findings == []
    # Some of it is noise; beside the edge of a box, whose faces go on, half of it is no tube's.
    assert len(selected(surface, fitted(line), owned=0.8)[0]) == 1
    assert_not_round(*selected(surface, fitted(line), owned=0.5))


def test_a_strand_with_a_profile_that_is_no_circle_is_no_string(seen: Callable, straight: Callable) -> None:
    line = straight((0, 0, R), (0.1, 0, R), 0.003)
    surface, _ = seen([line])
    assert len(selected(surface, replace(fitted(line), roundness_error_m=0.03 * R))[0]) == 1
    assert_not_round(*selected(with_face(surface, line), replace(fitted(line), roundness_error_m=0.05 * R)))


def test_a_strand_with_the_profile_of_a_square_bar_is_no_string_unless_it_may_be_either(
    seen: Callable, straight: Callable
) -> None:
    line = straight((0, 0, R), (0.1, 0, R), 0.003)
    surface, _ = seen([line])

    def is_kept_and_may_be_square(squareness: float, sigma: float) -> tuple[bool, bool]:
        strand = replace(fitted(line), squareness=squareness, squareness_sigma=sigma)
        kept, findings = selected(surface, strand)
        if kept:
            assert findings == []
        else:
            assert_not_round(kept, findings)
        return len(kept) == 1, max_squareness(strand) > MAX_SQUARENESS

    assert is_kept_and_may_be_square(0.1, 0.05) == (True, False)
    assert is_kept_and_may_be_square(-0.3, 0.05) == (True, False)
    assert is_kept_and_may_be_square(0.4, 0.05) == (False, True)
    # Two sigmas to either side.
    assert is_kept_and_may_be_square(0.1, 0.1) == (True, True)
    assert is_kept_and_may_be_square(0.4, 0.25) == (True, True)
    assert is_kept_and_may_be_square(0.0, np.inf) == (True, True)


def test_a_poorly_supported_or_short_piece_is_no_string(seen: Callable, straight: Callable) -> None:
    line, longer = straight((0, 0, R), (0.1, 0, R), 0.003), straight((0, 0.04, R), (0.12, 0.04, R), 0.003)
    surface, _ = seen([line, longer])
    assert len(selected(surface, fitted(line), fitted(longer))[0]) == 2
    # Less than half of it has the support of the longest.
    hardly = replace(fitted(line), support=np.where(np.arange(len(line)) < 10, 40.0, 4.0))
    (kept,), findings = selected(surface, hardly, fitted(longer))
    np.testing.assert_array_equal(kept.points, longer)
    assert_excluded(findings, "piece-hardly-seen", 0.1, (0.05, 0.0, R))
    (kept,), findings = selected(surface, fitted(line[:7]), fitted(longer))
    s = float(np.linalg.norm(line[6] - line[0]))
    assert_excluded(findings, "piece-too-short", s, (s / 2, 0.0, R))


def test_a_long_poorly_supported_piece_may_be_a_string(seen: Callable, straight: Callable) -> None:
    line, longer = straight((0, 0, R), (0.2, 0, R), 0.003), straight((0, 0.04, R), (0.22, 0.04, R), 0.003)
    surface, _ = seen([line, longer])
    hardly = replace(fitted(line), support=np.where(np.arange(len(line)) < 10, 40.0, 4.0))
    found = classified(surface, hardly, fitted(longer))
    (kept,) = found.strings
    np.testing.assert_array_equal(kept.points, longer)
    assert_excluded(found.findings, "possible-string", 0.2, (0.1, 0.0, R))
    assert found.findings[0].severity == "doubt"
    assert found.findings[0].message == (
        "excluded a piece of 200 mm at (100, 0, 4) mm, although it may be a string: "
        "hardly any surface supports it; scan again from more views"
    )


@pytest.mark.parametrize(("roundness_error_m", "lowered_m"), [(0.05 * R, 0.0), (0.0, 0.45 * R)])
def test_an_excluded_strand_that_lies_alone_may_be_a_string(
    seen: Callable, straight: Callable, roundness_error_m: float, lowered_m: float
) -> None:
    """A string of another radius, or on a table of another height, is not round or lies in the table."""
    line = straight((0, 0, R), (0.1, 0, R), 0.003)
    surface, _ = seen([line])
    strand = replace(fitted(line - (0, 0, lowered_m)), roundness_error_m=roundness_error_m)

    def codes(surface: np.ndarray, strand: FittedStrand, owned: float = 1.0) -> list[tuple[str, str]]:
        return [(found.code, found.severity) for found in classified(surface, strand, owned=owned).findings]

    excluded = [("piece-in-table" if lowered_m else "piece-not-round", "note")]
    assert codes(surface, strand) == [("possible-string", "doubt")]
    # An edge goes on as a face beside it.
    assert codes(with_face(surface, line), strand) == excluded
    # So does the edge of a small box, half of whose surface is on no tube.
    assert codes(surface, strand, owned=0.5) == [("piece-not-round", "note")]
    # A bar is square beyond doubt.
    assert codes(surface, replace(strand, squareness=0.8)) == [("piece-not-round", "note")]
    assert codes(surface, replace(strand, squareness=0.8, squareness_sigma=0.35)) == [("possible-string", "doubt")]


def test_the_surface_of_a_string_beside_an_excluded_strand_does_not_count(seen: Callable, straight: Callable) -> None:
    line, string = straight((0, 0, R), (0.1, 0, R), 0.003), straight((0, 3 * R, R), (0.12, 3 * R, R), 0.003)
    surface, _ = seen([line, string])
    thin = replace(fitted(line), roundness_error_m=0.05 * R)
    assert [found.code for found in classified(surface, thin, fitted(string)).findings] == ["possible-string"]


def test_a_short_strand_between_uneven_surface_is_a_ridge(seen: Callable, straight: Callable) -> None:
    line = straight((0, 0, R), (0.1, 0, R), 0.003)
    surface, _ = seen([line])

    def codes(strand: np.ndarray, surface: np.ndarray, left: float, right: float | None) -> list[str]:
        """Return the codes for a strand with faces on its sides that are as many metres higher at its other end."""
        for sign, rise in ((1, left), (-1, right)):
            if rise is not None:
                face = with_face(np.empty((0, 3)), strand) * (1, sign, 1)
                surface = np.vstack([surface, face + face[:, :1] / 0.1 * (0, 0, rise)])
        classification = classified(surface, fitted(strand))
        assert len(classification.strings) + len(classification.findings) == 1
        return [found.code for found in classification.findings]

    # The faces rise by a radius over the line; the 10th to 90th percentile is 0.8 radii.
    assert codes(line, surface, R, R) == ["possible-string"]
    assert codes(line, surface, R, None) == []  # a string beside a box
    assert codes(line, surface, 0.0, 0.0) == []  # a string on a plate
    longer = straight((0, 0, R), (0.2, 0, R), 0.003)
    assert codes(longer, seen([longer])[0], R, R) == []


def test_beside_a_string_a_straight_strand_of_another_radius_is_a_rod(seen: Callable, straight: Callable) -> None:
    string, line = straight((0, 0.05, R), (0.2, 0.05, R), 0.003), straight((0, 0, R), (0.12, 0, R), 0.003)
    string = string + np.sin(np.linspace(0, 3, len(string)))[:, None] * (0.0, 0.02, 0.0)
    surface, _ = seen([string, line])
    rod = replace(fitted(line), radius_m=1.3 * R, measured_radius_m=1.3 * R)
    found = classified(surface, fitted(string), rod)
    assert len(found.strings) == 1
    assert_excluded(found.findings, "possible-string", 0.12, (0.06, 0.0, R))
    assert "straight as a rod, and its radius is 5.5 mm" in found.findings[0].message
    # Alone, it may as well be a straight string for which a wrong radius was given.
    surface, _ = seen([line])
    (kept,), findings = selected(surface, rod)
    assert (kept.radius_m, findings) == (1.3 * R, [])


def test_an_upright_strand_is_no_string(seen: Callable, straight: Callable) -> None:
    string, post = straight((0, 0, R), (0.2, 0, R), 0.003), straight((0, 0.05, R), (0, 0.05, 0.06), 0.003)
    around = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    side = np.column_stack([np.cos(around), np.sin(around), np.zeros(12)])
    surface = np.vstack([seen([string])[0], (post[:, None] + R * side).reshape(-1, 3)])
    (kept,), findings = selected(surface, fitted(string), fitted(post))
    np.testing.assert_array_equal(kept.points, string)
    assert_excluded(findings, "piece-upright", 0.06 - R, (0.0, 0.05, (0.06 + R) / 2))


def test_a_short_strand_that_is_thin_and_high_is_a_fold(seen: Callable, straight: Callable) -> None:
    string, top = straight((0, 0.05, R), (0.2, 0.05, R), 0.003), straight((0, 0, 1.2 * R), (0.1, 0, 1.2 * R), 0.003)
    surface, _ = seen([string, top])
    fold = replace(fitted(top), radius_m=0.7 * R, measured_radius_m=0.7 * R)
    fold = replace(fold, points=top + np.sin(np.linspace(0, 3, len(top)))[:, None] * (0.0, 0.005, 0.0))
    found = classified(surface, fitted(string), fold)
    assert len(found.strings) == 1
    assert [(finding.code, finding.severity) for finding in found.findings] == [("possible-string", "doubt")]
    assert "as a fold" in found.findings[0].message


def test_surface_on_the_tube_of_another_strand_does_not_count(seen: Callable, straight: Callable) -> None:
    # A string, and a rim beside it: half of what is nearest to the rim lies on no tube, or on the string's.
    line, rim = straight((0, 0, R), (0.12, 0, R), 0.003), straight((0, 2 * R, R), (0.1, 2 * R, R), 0.003)
    surface, _ = seen([line, rim])
    beside_rim = surface[:, 1] > R
    half = beside_rim & (np.arange(len(surface)) % 2 == 0)
    for elsewhere in (-1, 0):
        owner = np.where(half, elsewhere, beside_rim.astype(np.int64))
        found = Refinement([fitted(line), fitted(rim)], owner, 0.0002)
        classification = classify_strings(found, surface, PARAMETERS)
        (kept,) = classification.strings
        np.testing.assert_array_equal(kept.points, line)
        assert_excluded(classification.findings, "piece-not-round", 0.1, (0.05, 2 * R, R))


def test_strings_are_in_canonical_order_and_direction(seen: Callable, straight: Callable) -> None:
    lines = [straight((0.08, 0, R), (0, 0, R), 0.003), straight((0.1, 0.04, R), (-0.02, 0.05, R), 0.003)]
    kept, _ = selected(seen(lines)[0], *map(fitted, lines))
    # x + y / 2 of their means is 40 mm and 62 mm, whatever their lengths are.
    np.testing.assert_array_equal(kept[0].points, lines[0][::-1])
    np.testing.assert_array_equal(kept[1].points, lines[1][::-1])


def test_reversing_a_strand_reverses_all_values_of_its_points(seen: Callable, straight: Callable) -> None:
    line = straight((0.1, 0, R), (0, 0, R), 0.003)
    support = np.linspace(10.0, 50.0, len(line))
    bridged = np.arange(len(line)) < 3
    (strand,), _ = selected(seen([line])[0], replace(fitted(line), support=support, bridged=bridged))
    np.testing.assert_array_equal(strand.points, line[::-1])
    np.testing.assert_array_equal(strand.support, support[::-1])
    np.testing.assert_array_equal(strand.bridged, bridged[::-1])


def test_no_strands_no_strings() -> None:
    nothing = classify_strings(Refinement([], np.empty(0, dtype=np.int64), 0.0), np.empty((0, 3)), PARAMETERS)
    assert (nothing.strings, nothing.findings) == ((), ())


def test_a_tube_that_reaches_into_the_table_is_no_string(seen: Callable, straight: Callable) -> None:
    line = straight((0, 0, R), (0.1, 0, R), 0.003)
    surface, _ = seen([line])
    sunk = line - (0, 0, 0.45 * R)
    kept, findings = selected(with_face(surface, line), fitted(sunk))
    assert kept == []
    assert_excluded(findings, "piece-in-table", 0.1, (0.05, 0.0, 0.55 * R))
    # One end alone may be wrong; and heights count from the table.
    sunk[4:, 2] = R
    assert len(selected(surface, fitted(sunk))[0]) == 1
    lower = fitted(line - (0, 0, R))
    refinement = Refinement([lower], np.zeros(len(surface), dtype=np.int64), 0.0002)
    assert len(classify_strings(refinement, surface - (0, 0, R), PARAMETERS, SupportSurface(-R)).strings) == 1
