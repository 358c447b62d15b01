"""From strands to the chains of the model."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from recognition.geometry.polyline import arc_length
from recognition.messages import format_position
from recognition.model.chain_order import canonical_order
from recognition.model.model import Chain
from recognition.parameters import ChainParameters
from recognition.preprocessing.normals import NormalCloud
from recognition.preprocessing.target_cloud import Scene
from recognition.shirakawa.end_extension import classify_ends
from recognition.shirakawa.evidence import point_uncertainty
from recognition.strand import Strand

SHARP_RAD = np.radians(75)
"""A turn beyond this over r_f to either side is not a string's."""


def assemble_chains(
    strands: Sequence[Strand],
    single: NDArray[np.float64],
    clouds: Sequence[NormalCloud],
    scene: Scene,
    parameters: ChainParameters,
) -> tuple[list[Strand], tuple[Chain, ...], list[str]]:
    """The strands in the model's order and direction, the chains made of them, and what was left out, in words.

    The longest chain comes first. Strands shorter than r_cn, an intersection's extent, are an
    intersection's remains or noise, and are left out.
    """
    kept, warnings = [], []
    for strand in strands:
        length = float(arc_length(strand.points)[-1])
        if length >= parameters.r_cn:
            kept.append(_directed(strand))
        else:
            warnings.append(
                f"left out a piece of {length * 1000:.0f} mm at {format_position(strand.points.mean(axis=0))}: "
                "too short to be told from noise"
            )
    kept.sort(key=lambda strand: -arc_length(strand.points)[-1])
    if not kept:
        warnings.insert(0, "no string found: nothing above the table is long and thin")
    chains = []
    for number, strand in enumerate(kept):
        sigma_m, views = point_uncertainty(strand, clouds, parameters)
        ends = classify_ends(strand, single, scene, parameters)
        chains.append(Chain(number, strand.closed, parameters.r, strand.points, sigma_m, views, ends))
    return kept, tuple(chains), warnings


def _directed(strand: Strand) -> Strand:
    order = canonical_order(strand.points, strand.closed)
    return replace(strand, points=strand.points[order], bridged=strand.bridged[order])


def sharp_bend_messages(chains: Sequence[Chain]) -> list[str]:
    """In words, where a chain turns more sharply than a string does: there it may have taken the wrong strand.

    Compared are the directions over r_f before and behind each point. A string of radius r that bends by more than
    `SHARP_RAD` within that has a bending radius of about r.
    """
    found = []
    for chain in chains:
        step = max(round(2 * chain.radius_m / max(chain.length_m / max(len(chain.points) - 1, 1), 1e-9)), 1)
        if len(chain.points) <= 2 * step:
            continue
        ways = chain.points[step:] - chain.points[:-step]
        ways = ways / np.maximum(np.linalg.norm(ways, axis=1, keepdims=True), 1e-12)
        cosine = (ways[step:] * ways[:-step]).sum(axis=1)
        sharpest = int(cosine.argmin())
        if cosine[sharpest] < np.cos(SHARP_RAD):
            found.append(
                f"chain {chain.id} bends sharply at {format_position(chain.points[sharpest + step])}: "
                "it may have taken the wrong strand at a crossing"
            )
    return found
