"""What recognition made of each view, in short."""

from dataclasses import dataclass
from typing import Literal

from recognition.pipeline import Recognition


@dataclass(frozen=True)
class ViewOutcome:
    """One view."""

    index: int
    left_out: Literal["nothing_seen", "contradicting"] | None
    """Why it was not used; None: it was."""
    correction_m: float | None
    """How far registration moved it; None where it was not registered."""
    correction_rad: float | None


def view_outcomes(recognition: Recognition) -> tuple[ViewOutcome, ...]:
    """Of each view that recognition was given."""
    registered = recognition.registration
    compared = set() if registered is None else {view.index for view in registered.views}

    def left_out(index: int) -> Literal["nothing_seen", "contradicting"]:
        return "contradicting" if index in compared else "nothing_seen"

    return tuple(
        ViewOutcome(view.index, None if view.used else left_out(view.index), view.correction_m, view.correction_rad)
        for view in recognition.model.quality.views
    )
