"""Bending energy of the curve that joins two ends.

A string takes the shape of least bending energy under the constraints of its contacts. In a tight knot, it turns by a
right angle and more where it is hidden under another strand. The extrapolation of its ends says little there, but the
curve that must join two ends of the same strand still bends less than one that joins ends of two strands.
"""

import numpy as np
from numpy.typing import NDArray

Vectors = NDArray[np.float64]


def joining_energy(chord: Vectors, leaving: Vectors, arriving: Vectors, k_a: Vectors, k_b: Vectors) -> Vectors:
    """Return the least bending energy of curves between two ends, beyond that of the bends that the ends continue.

    A clothoid continues the curvatures of the ends: its curvature changes linearly from `k_a` to `k_b` over the length
    L of the chord. It leaves the chord at -L (2 k_a + k_b) / 6 and arrives at L (k_a + 2 k_b) / 6. The directions of
    the ends differ from these angles by a and b. A curve with small slopes that turns by a at its start and by b at its
    end has a bending energy of at least 4 (|a|^2 + a.b + |b|^2) / L, the energy of a cubic. If the ends continue
    without curvature, this is the bending energy of the joining curve itself.

    Args:
        chord: (M, 3) vectors from the first to the second end, metres.
        leaving: (M, 3) directions in which the curves leave the first end.
        arriving: (M, 3) directions in which the curves arrive at the second end.
        k_a: (M, 3) curvature vectors at the first end, 1/m; zero for none.
        k_b: (M, 3) curvature vectors at the second end, 1/m.

    Returns:
        Integrals (M,) of the squared curvature over the length, 1/m.

    Source:
        The energy of a cubic is that of an Euler-Bernoulli beam with given slopes at both ends. Horn, "The curve of
        least energy" (1983), discusses the exact curve.
    """
    length = np.linalg.norm(chord, axis=1)[:, None]
    k_a, k_b = _turned_across(k_a, chord), _turned_across(k_b, chord)
    a = _deviation(leaving, chord) + length * (2 * k_a + k_b) / 6
    b = _deviation(arriving, chord) - length * (k_a + 2 * k_b) / 6
    return 4 * ((a * a).sum(axis=1) + (a * b).sum(axis=1) + (b * b).sum(axis=1)) / np.maximum(length[:, 0], 1e-9)


def _deviation(directions: Vectors, chord: Vectors) -> Vectors:
    """Return the rotation of each direction from the chord, as vectors (M, 3) across the chord of that angle, rad."""
    direction = directions / np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-12)
    along = chord / np.maximum(np.linalg.norm(chord, axis=1, keepdims=True), 1e-12)
    cosine = np.clip((direction * along).sum(axis=1, keepdims=True), -1, 1)
    across = direction - cosine * along
    return across * np.arccos(cosine) / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)


def _turned_across(vectors: Vectors, chord: Vectors) -> Vectors:
    """Return vectors of the same lengths (M, 3), without their components along the chord.

    The curvature of an end is perpendicular to its direction, while angles are counted across the chord.
    """
    along = chord / np.maximum(np.linalg.norm(chord, axis=1, keepdims=True), 1e-12)
    across = vectors - (vectors * along).sum(axis=1, keepdims=True) * along
    size = np.linalg.norm(vectors, axis=1, keepdims=True)
    return across * size / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)
