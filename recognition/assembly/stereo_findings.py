"""Findings on the errors of stereo matching: those that were corrected, and a radius measured in such depth."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from recognition.depth_correction.drawn_strings import DrawnViews
from recognition.depth_correction.pixel_locking import PixelLocking
from recognition.model.chains import Chain
from recognition.model.findings import Finding, finding
from recognition.refinement.refinement import Refinement

MIN_SHIFT_RADII = 0.06
"""Minimum shift of heights or ends that is worth a note, in radii r. Without windows, both are less."""


@dataclass(frozen=True)
class _Correction:
    """A correction of the depth, or of what was measured in it."""

    size_m: float
    """Largest shift, metres."""
    message: str
    """What was corrected, and by how much."""


def stereo_findings(
    locking: PixelLocking | None,
    compression: float,
    drawn: DrawnViews | None,
    refinement: Refinement | None,
    r: float,
) -> Sequence[Finding]:
    """Return the note on errors of stereo matching that were corrected, or none.

    Args:
        locking: Pixel locking that was subtracted, or None.
        compression: Compression of heights that was restored; 1 if there was none.
        drawn: Views into which strings were drawn, or None.
        refinement: Strands with corrected heights and ends; None without strings, or for a method without them.
        r: Radius of the strings, metres.
    """
    corrections = [*_corrections_of_depth(locking, compression, drawn, r)]
    if refinement is not None:
        corrections += _corrections_of_strings(refinement, MIN_SHIFT_RADII * r)
    if not corrections:
        return ()
    listed = "; ".join(correction.message for correction in corrections)
    largest_m = max(correction.size_m for correction in corrections)
    return (finding("stereo-depth-corrected", f"errors of stereo matching were corrected: {listed}", value=largest_m),)


def uncertain_radius_findings(is_matched: bool, r: float, chains: Sequence[Chain]) -> Sequence[Finding]:
    """Return the doubt about a radius that was measured in matched depth, or none. It concerns all chains.

    Windows change height and width of strings, so that neither shows the radius exactly.

    Args:
        is_matched: Whether the depth was matched in windows.
        r: Measured radius of the strings, metres.
        chains: Chains of the model.
    """
    if not is_matched or not chains:
        return ()
    message = (
        f"the radius {_mm(r)} was measured in depth of a stereo camera, where it can be wrong by a quarter or more: "
        "give the radius of the string"
    )
    return (finding("radius-uncertain", message, chains=[chain.id for chain in chains], value=r),)


def _corrections_of_depth(
    locking: PixelLocking | None, compression: float, drawn: DrawnViews | None, r: float
) -> Iterator[_Correction]:
    """Yield the corrections of the depth images."""
    if locking is not None:
        size_m = locking.amplitude_m
        depth = f"{locking.depth_m:.2f} m"
        yield _Correction(
            size_m, f"stripes of up to {_mm(size_m)} on the table, at a depth of {depth}, were subtracted"
        )
    if drawn is not None:
        message = "strings were drawn as tubes along their bands in the image, as all views are from one viewpoint"
        if drawn.lost_m > MIN_SHIFT_RADII * r:
            message += f", where their heights are uneven, in places {_mm(drawn.lost_m)} too low"
        yield _Correction(drawn.lost_m, message)
    elif compression < 1:
        size_m = (1 - compression) * 2 * r
        yield _Correction(size_m, f"heights of strings, measured at {compression * 100:.0f} %, were restored")


def _corrections_of_strings(refinement: Refinement, min_shift_m: float) -> Iterator[_Correction]:
    """Yield the corrections of the fitted strands."""
    size_m = abs(refinement.lost_m)
    if size_m > min_shift_m:
        verb = "raised" if refinement.lost_m > 0 else "lowered"
        yield _Correction(size_m, f"resting strings were {verb} by {_mm(size_m)}")
    size_m = abs(refinement.border_offset_m)
    if size_m > min_shift_m:
        direction = "inwards" if refinement.border_offset_m > 0 else "outwards"
        yield _Correction(size_m, f"ends were moved {direction} by {_mm(size_m)}")


def _mm(length_m: float) -> str:
    """Return a length as text."""
    return f"{length_m * 1000:.1f} mm"
