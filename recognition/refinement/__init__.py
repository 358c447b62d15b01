"""Refinement: fit tubes to the measured surface, and classify the fitted strands as string or not string.

The input is the traced strands and the registered surface with its normals. The output is the fitted strands with
radii, localised ends and measures of their cross-sections. A classifier separates strings from object edges and noise.

The method is not in the paper. It replaces the means of eqs. (2) and (3), which are biased upwards and inwards.
"""

from recognition.refinement.refinement import FittedStrand, Refinement, refine
from recognition.refinement.string_classifier import StringClassification, classify_strings

__all__ = ["FittedStrand", "Refinement", "StringClassification", "classify_strings", "refine"]
