"""How exactly corners were found, by how well they lie on one flat board."""

import math

import numpy as np
from numpy.typing import NDArray

from calibration.target.board import Board
from calibration.target.corner_refinement import apply_homography

FEWEST = 12
"""Fewer corners leave too little over to judge by."""
BENT_FROM = 24
"""So many corners bear a lens's bending to be fitted too."""
PASSES = 3
FAR = 6.0
"""Standard deviations from which on a corner is another thing: a cable across it, a reflection."""
FAR_PX = 0.1
"""... and at least this: a little error does not make a corner worse than none."""
GAUSSIAN = 1.4826
"""Standard deviation of a normal distribution by the median of its absolute values."""


def check_planarity(
    board: Board, ids: NDArray[np.int64], pixels: NDArray[np.float64]
) -> tuple[NDArray[np.bool_], float | None]:
    """Which of the corners `ids` (N,) found at `pixels` (N, 2) lie on one flat board (N,), and the standard deviation
    (px) of one coordinate of these.

    Compared with a homography, and with cubic polynomials for the lens where there are corners enough. Smooth errors,
    as of a board that is bent, are explained by these: what remains is the noise. With too few corners to tell, all
    are taken to be right and the deviation is None.
    """
    agree = np.ones(len(ids), dtype=bool)
    sigma = None
    if len(ids) < FEWEST:
        return agree, sigma
    places = board.points[ids, :2] / board.pitch_m
    for _ in range(PASSES):
        residuals, unknowns = _residuals(places, pixels, agree)
        kept = int(agree.sum())
        # Of what is fitted to, less is left over than there is noise.
        left_over = math.sqrt(1.0 - unknowns / (2 * kept))
        sigma = GAUSSIAN * float(np.median(np.abs(residuals[agree]))) / left_over
        near = np.linalg.norm(residuals, axis=1) <= max(FAR * sigma, FAR_PX)
        if near.sum() < FEWEST or (near == agree).all():
            break
        agree = near
    return agree, sigma


def _residuals(
    places: NDArray[np.float64], pixels: NDArray[np.float64], agree: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], int]:
    """(N, 2) px, of a fit to those that agree, and how many unknowns it had."""
    import cv2

    H = np.asarray(cv2.findHomography(places[agree], pixels[agree], 0)[0], dtype=np.float64)
    residuals = pixels - apply_homography(H, places)
    if agree.sum() < BENT_FROM:
        return residuals, 8
    x, y = (2 * (places - places.min(axis=0)) / np.maximum(np.ptp(places, axis=0), 1e-9) - 1).T
    powers = [(i, j) for i in range(4) for j in range(4 - i)]
    terms = np.column_stack([x**i * y**j for i, j in powers])
    bend = np.linalg.lstsq(terms[agree], residuals[agree], rcond=None)[0]
    # The homography's own unknowns are nearly all among the polynomials'.
    return residuals - terms @ bend, 2 * len(powers)
