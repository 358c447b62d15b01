"""Refinement of the strands: tubes fitted to the measured surface, and which of them are strings.

Traced strands and the registered surface with its normals go in. Fitted strands with radii, localised ends and measures
of their cross-sections come out; a classifier then separates the strings from edges of objects and noise. The method is
ours: it replaces the means of eqs. (2) and (3) of the paper, which are biased upwards and inwards.
"""

from recognition.refinement.refinement import FittedStrand, Refinement, refine
from recognition.refinement.string_classifier import StringClassification, classify_strings

__all__ = ["FittedStrand", "Refinement", "StringClassification", "classify_strings", "refine"]
