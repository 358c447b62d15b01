"""Assembly of the model's chains and crossings from fitted strands.

The input is the fitted strands, the registered surface and the scene. The output is the chains with their sigmas, view
counts and ends, the crossings, the surface that belongs to no chain, and messages about uncertain results.
"""

from recognition.assembly.chain_ends import mark_facing_ends, mark_unobserved_ends
from recognition.assembly.chains import ChainAssembly, assemble_fitted_chains
from recognition.assembly.crossings import CrossingSet, find_crossings, find_fitted_crossings
from recognition.assembly.sharp_bends import sharp_bend_messages
from recognition.assembly.unexplained import find_unexplained_surface, unexplained_messages

__all__ = [
    "ChainAssembly",
    "CrossingSet",
    "assemble_fitted_chains",
    "find_crossings",
    "find_fitted_crossings",
    "find_unexplained_surface",
    "mark_facing_ends",
    "mark_unobserved_ends",
    "sharp_bend_messages",
    "unexplained_messages",
]
