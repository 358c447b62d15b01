"""Chains whose ends are checked against the surface that no chain explains, and against free space."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recognition.assembly.branches import mark_branches
from recognition.assembly.chain_ends import (
    mark_ends_at_unexplained_surface,
    mark_ends_before_low_parts,
    mark_ends_without_free_space,
    mark_touching_ends,
)
from recognition.assembly.unexplained import find_unexplained_surface
from recognition.ingestion.seen_cells import is_single_viewpoint
from recognition.model.chains import Chain, Crossing
from recognition.model.findings import Finding
from recognition.surface import Surface


@dataclass(frozen=True, eq=False)
class CheckedChains:
    """Chains with the kinds of their ends, and the surface that they do not explain."""

    chains: tuple[Chain, ...]
    """Chains in the order of their `id`."""
    crossings: tuple[Crossing, ...]
    """Crossings of the chains."""
    contact_findings: Sequence[Finding]
    """Findings on ends that may be joined to another end, or to the side of a strand."""
    points: NDArray[np.float64]
    """(N, 3) points of strings and of objects on which no string rests, metres."""
    unexplained: Sequence[NDArray[np.float64]]
    """(M, 3) points of each piece of that surface that belongs to no chain, metres, the largest piece first."""


def check_chains(chains: Sequence[Chain], crossings: tuple[Crossing, ...], surface: Surface) -> CheckedChains:
    """Mark the ends at which the string may continue, or which may be joined to another strand.

    Args:
        chains: Chains as a method found them.
        crossings: Their crossings.
        surface: Registered surface of the scene.
    """
    parameters = surface.parameters
    points = surface.support.remove_from(surface.points, chains, parameters)
    unexplained = find_unexplained_surface(points, chains, parameters)
    chains = mark_ends_at_unexplained_surface(chains, unexplained, parameters)
    chains, touching = mark_touching_ends(chains, surface.clouds)
    chains, branches = mark_branches(chains, surface.clouds)
    chains = mark_ends_without_free_space(chains, surface.clouds, parameters)
    if is_single_viewpoint(surface.clouds):
        chains = mark_ends_before_low_parts(chains, unexplained, parameters)
    return CheckedChains(chains, crossings, [*touching, *branches], points, unexplained)
