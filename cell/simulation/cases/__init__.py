"""Simulated cases in tiers, from the scene of the paper to hard scenes. The benchmark recognises them.

In: name of a tier, and a seed. Out: the scene on the table, the camera, the errors of the reported poses, and their
simulated scan.
"""

from cell.simulation.cases.case import Case, TierError, simulate
from cell.simulation.cases.tiers import TIERS, make_case

__all__ = ["TIERS", "Case", "TierError", "make_case", "simulate"]
