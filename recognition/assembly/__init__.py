"""Assembly of the model's chains and crossings from fitted strands.

The input is the fitted strands, the registered surface and the scene. The output is the chains with their sigmas, view
counts and ends, the crossings, the surface that belongs to no chain, and the findings on all of them.
"""

from recognition.assembly.chain_ends import (
    mark_ends_at_unexplained_surface,
    mark_ends_without_free_space,
    mark_touching_ends,
    unobserved_end_findings,
)
from recognition.assembly.chains import ChainAssembly, assemble_fitted_chains
from recognition.assembly.connections import connection_findings
from recognition.assembly.crossings import CrossingSet, find_crossings, find_fitted_crossings
from recognition.assembly.sharp_bends import sharp_bend_findings
from recognition.assembly.unexplained import (
    find_unexplained_surface,
    possible_object_findings,
    unexplained_findings,
)
from recognition.assembly.view_findings import drift_findings, view_findings

__all__ = [
    "ChainAssembly",
    "CrossingSet",
    "assemble_fitted_chains",
    "connection_findings",
    "drift_findings",
    "find_crossings",
    "find_fitted_crossings",
    "find_unexplained_surface",
    "mark_ends_at_unexplained_surface",
    "mark_ends_without_free_space",
    "mark_touching_ends",
    "possible_object_findings",
    "sharp_bend_findings",
    "unexplained_findings",
    "unobserved_end_findings",
    "view_findings",
]
