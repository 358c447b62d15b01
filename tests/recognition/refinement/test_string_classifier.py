"""Classification of fitted strands by the surface beside them."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from recognition.parameters import ChainParameters
from recognition.refinement.refinement import FittedStrand, Refinement
from recognition.refinement.string_classifier import StringClassification, classify_strings, may_be_square

R = 0.0042
PARAMETERS = ChainParameters.for_radius(R)
NOT_ROUND = ["excluded a piece of 100 mm at (50, 0, 4) mm: not round like a string"]


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


def selected(surface: np.ndarray, *strands: FittedStrand, owned: float = 1.0) -> tuple[list[FittedStrand], list[str]]:
    """Return the strings and the warnings of a classification without ambiguities."""
    found = classified(surface, *strands, owned=owned)
    assert found.ambiguities == ()
    return list(found.strings), list(found.warnings)


def classified(surface: np.ndarray, *strands: FittedStrand, owned: float = 1.0) -> StringClassification:
    """Classify strands. The share `owned` of the surface nearest to each lies on its tube, and the rest on none."""
    distance = np.array([np.linalg.norm(surface[:, None] - s.points, axis=2).min(axis=1) for s in strands])
    on = np.arange(len(surface)) % 100 < 100 * owned
    return classify_strings(
        Refinement(list(strands), np.where(on, distance.argmin(axis=0), -1), 0.0002), surface, PARAMETERS
    )


def test_a_string_has_its_surface_to_itself(seen: Callable, straight: Callable) -> None:
    line = straight((0, 0, R), (0.1, 0, R), 0.003)
    surface, _ = seen([line])
    (kept,), warnings = selected(surface, fitted(line))
    np.testing.assert_array_equal(kept.points, line)
    assert warnings == []
    # Some of it is noise; beside the edge of a box, whose faces go on, half of it is no tube's.
    assert len(selected(surface, fitted(line), owned=0.8)[0]) == 1
    assert selected(surface, fitted(line), owned=0.5) == ([], NOT_ROUND)


def test_a_strand_with_a_profile_that_is_no_circle_is_no_string(seen: Callable, straight: Callable) -> None:
    line = straight((0, 0, R), (0.1, 0, R), 0.003)
    surface, _ = seen([line])
    assert len(selected(surface, replace(fitted(line), roundness_error_m=0.03 * R))[0]) == 1
    assert selected(surface, replace(fitted(line), roundness_error_m=0.05 * R)) == ([], NOT_ROUND)


def test_a_strand_with_the_profile_of_a_square_bar_is_no_string_unless_it_may_be_either(
    seen: Callable, straight: Callable
) -> None:
    line = straight((0, 0, R), (0.1, 0, R), 0.003)
    surface, _ = seen([line])

    def is_kept_and_may_be_square(squareness: float, sigma: float) -> tuple[bool, bool]:
        strand = replace(fitted(line), squareness=squareness, squareness_sigma=sigma)
        kept, warnings = selected(surface, strand)
        assert warnings == ([] if kept else NOT_ROUND)
        return len(kept) == 1, may_be_square(strand)

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
    (kept,), warnings = selected(surface, hardly, fitted(longer))
    np.testing.assert_array_equal(kept.points, longer)
    assert warnings == ["excluded a piece of 100 mm at (50, 0, 4) mm: hardly seen"]
    (kept,), warnings = selected(surface, fitted(line[:7]), fitted(longer))
    assert warnings == ["excluded a piece of 18 mm at (9, 0, 4) mm: too short to be distinguished from noise"]


def test_a_long_poorly_supported_piece_may_be_a_string(seen: Callable, straight: Callable) -> None:
    line, longer = straight((0, 0, R), (0.2, 0, R), 0.003), straight((0, 0.04, R), (0.22, 0.04, R), 0.003)
    surface, _ = seen([line, longer])
    hardly = replace(fitted(line), support=np.where(np.arange(len(line)) < 10, 40.0, 4.0))
    found = classified(surface, hardly, fitted(longer))
    (kept,) = found.strings
    np.testing.assert_array_equal(kept.points, longer)
    assert found.ambiguities == ("excluded a piece of 200 mm at (100, 0, 4) mm: hardly seen, so it may be a string",)
    assert found.warnings == ()


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
        assert len(classification.warnings) == 1


def test_the_longest_comes_first_and_each_begins_at_the_smaller_x(seen: Callable, straight: Callable) -> None:
    lines = [straight((0.08, 0, R), (0, 0, R), 0.003), straight((0.1, 0.04, R), (-0.02, 0.05, R), 0.003)]
    kept, _ = selected(seen(lines)[0], *map(fitted, lines))
    np.testing.assert_array_equal(kept[0].points, lines[1][::-1])
    np.testing.assert_array_equal(kept[1].points, lines[0][::-1])


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
    assert (nothing.strings, nothing.ambiguities, nothing.warnings) == ((), (), ())


def test_a_tube_that_reaches_into_the_table_is_no_string(seen: Callable, straight: Callable) -> None:
    line = straight((0, 0, R), (0.1, 0, R), 0.003)
    surface, _ = seen([line])
    sunk = line - (0, 0, 0.45 * R)
    assert selected(surface, fitted(sunk)) == (
        [],
        ["excluded a piece of 100 mm at (50, 0, 2) mm: its tube would reach into the table"],
    )
    # One end alone may be wrong; and heights count from the table.
    sunk[4:, 2] = R
    assert len(selected(surface, fitted(sunk))[0]) == 1
    lower = fitted(line - (0, 0, R))
    refinement = Refinement([lower], np.zeros(len(surface), dtype=np.int64), 0.0002)
    assert len(classify_strings(refinement, surface - (0, 0, R), PARAMETERS, -R).strings) == 1
