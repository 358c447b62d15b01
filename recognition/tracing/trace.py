"""The graph method: strands as paths through all nodes of the centre line, joined at all intersections at once."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recognition.errors import TooCrowdedError
from recognition.messages import format_position
from recognition.parameters import ChainParameters
from recognition.strand import End, Strand, join
from recognition.tracing.end_pairing import Pairing, pair_ends
from recognition.tracing.fragments import Fragment, link_nodes, split_over_bare_table
from recognition.tracing.height_map import HeightMap
from recognition.tracing.merged_strands import split_merged_strands
from recognition.tracing.nodes import CentreLineNodes, extract_nodes

MAX_FRAGMENTS = 1000
"""Fragments taken; ten metres of string with a hundred crossings have a few hundred."""


@dataclass(frozen=True, eq=False)
class TracedStrands:
    """Strands and what they were made of."""

    nodes: CentreLineNodes
    fragments: list[Fragment]
    pairing: Pairing
    strands: list[Strand]


def trace_strands(single: NDArray[np.float64], cover: HeightMap, parameters: ChainParameters) -> TracedStrands:
    """The strands in the centre points c_i (`single`, (N, 3), eq. 1), seen from above in `cover`.

    The matching method walks from point to point and must know an intersection when it meets one. Here nothing is
    walked: nodes know their direction, so that crossing strands keep apart even where they melt together; where a
    strand dives under another, or the measurement has a hole, its fragments end; and which ends belong together is
    decided for all of them at once.

    Raises:
        TooCrowdedError: more fragments than strings make.
    """
    nodes = extract_nodes(single, parameters)
    fragments = split_over_bare_table(link_nodes(nodes, parameters), cover, parameters.r)
    fragments = split_merged_strands(fragments, cover.surface, parameters)
    if len(fragments) > MAX_FRAGMENTS:
        raise TooCrowdedError(
            f"what is above the table falls into {len(fragments)} pieces: check the string's radius and the workspace"
        )
    pairing = pair_ends(fragments, cover, parameters)
    pieces = [Strand(f.points, np.zeros(len(f.points), dtype=bool), f.closed) for f in fragments]
    ends = [
        End(int(fragment), number % 2 == 0, pairing.ends.points[number], pairing.ends.directions[number])
        for number, fragment in enumerate(pairing.ends.fragment)
    ]
    return TracedStrands(nodes, fragments, pairing, join(pieces, ends, pairing.couples, parameters))


def pairing_messages(pairing: Pairing) -> list[str]:
    """In words, where other couples of ends would be nearly as good."""
    return [
        f"at {format_position(place)} the strands may be connected differently: which ends belong together is not "
        "certain"
        for place in pairing.doubts
    ]
