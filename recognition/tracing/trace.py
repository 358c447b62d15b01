"""Tracing of strands by the graph method: from centre points to nodes, fragments and strands."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recognition.errors import TooCrowdedError
from recognition.parameters import ChainParameters
from recognition.strand import End, Strand, join_strands
from recognition.tracing.end_pairing import FragmentEnds, Pairing, pair_ends
from recognition.tracing.fragments import Fragment, link_nodes, split_over_bare_table
from recognition.tracing.merged_strands import split_merged_strands
from recognition.tracing.nodes import CentreLineNodes, extract_nodes
from recognition.tracing.occlusion_map import OcclusionMap

MAX_FRAGMENTS = 1000
"""Maximum number of fragments. Ten metres of string with a hundred crossings have a few hundred fragments."""


@dataclass(frozen=True, eq=False)
class TracedStrands:
    """Strands of a scene, with the results of the tracing steps."""

    nodes: CentreLineNodes
    """Nodes of the centre line."""
    fragments: list[Fragment]
    """Visible parts of the centre lines."""
    pairing: Pairing
    """Ends of the fragments, and the pairs of ends that are joined."""
    strands: list[Strand]
    """Strands: the fragments, joined at the pairs of ends."""


def trace_strands(
    centre_points: NDArray[np.float64],
    occlusion_map: OcclusionMap,
    parameters: ChainParameters,
    table_z_m: float = 0.0,
) -> TracedStrands:
    """Trace the strands along the centre points.

    Nodes with a direction are linked to form fragments. A fragment ends where its strand passes under another strand,
    or where the measurement has a gap. All ends of the scene are then paired at once, and each pair of ends is joined.

    Args:
        centre_points: (N, 3) centre points c_i of eq. (1), metres, base frame.
        occlusion_map: Occlusion map of the registered surface.
        parameters: Method parameters; uses the radius r, the length r_f of an end and the spacing r_n of bridges.
        table_z_m: Height of the table, metres, base frame.

    Returns:
        The strands, with their nodes, fragments and pairs of ends.

    Raises:
        TooCrowdedError: The scene has more than `MAX_FRAGMENTS` fragments, too many for strings.

    Source:
        The graph method is not in the paper. It replaces the matching methods (sections II.G and III.B to III.E). A
        matching method links points one after the other and must detect each intersection on its path. Here, the
        directions of the nodes keep crossing strands apart, and one optimisation generalises eq. (8).
    """
    nodes = extract_nodes(centre_points, parameters)
    fragments = split_over_bare_table(link_nodes(nodes, parameters), occlusion_map, parameters.r)
    fragments = split_merged_strands(fragments, occlusion_map.surface, parameters)
    if len(fragments) > MAX_FRAGMENTS:
        raise TooCrowdedError(
            f"the points above the table form {len(fragments)} fragments, too many for strings: check the string's "
            "radius and the workspace"
        )
    pairing = pair_ends(fragments, occlusion_map, parameters, table_z_m)
    pieces = [Strand(f.points, np.zeros(len(f.points), dtype=bool), f.closed) for f in fragments]
    strands = join_strands(pieces, _strand_ends(pairing.ends), pairing.pairs, parameters, pairing.bridges)
    return TracedStrands(nodes, fragments, pairing, strands)


def _strand_ends(ends: FragmentEnds) -> list[End]:
    """Return the ends of fragments as ends of strands, in the same order."""
    found = []
    for k, fragment in enumerate(ends.fragment.tolist()):
        # The first point of a fragment comes before its last point.
        is_start = k % 2 == 0
        found.append(End(fragment, is_start, ends.points[k], ends.directions[k]))
    return found
