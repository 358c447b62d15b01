"""Solver: board corners, board poses and flange poses go in, the camera pose with its covariance comes out.

`estimate_initial_guess` finds a rough solution. `adjust` refines the solution by bundle adjustment and estimates the
noise levels. `cross_validate` computes the leave-one-out errors, by which `reject_outliers` excludes inconsistent
views. `model_systematic_errors` adjusts the remaining views again, with smooth robot errors and correlated corner
errors. `estimate_residual_distortion` estimates the remaining lens distortion.
"""

from calibration.solver.adjustment import Adjustment
from calibration.solver.bundle_adjustment import adjust
from calibration.solver.cross_validation import CrossValidation, cross_validate
from calibration.solver.initialisation import InitialGuess, estimate_initial_guess
from calibration.solver.noise import NoiseLevel, NoisePriors
from calibration.solver.outlier_rejection import ConsistentSolution, reject_outliers
from calibration.solver.problem import Problem, Unknowns
from calibration.solver.residual_distortion import ResidualDistortion, estimate_residual_distortion
from calibration.solver.systematic_errors import model_systematic_errors

__all__ = [
    "Adjustment",
    "ConsistentSolution",
    "CrossValidation",
    "InitialGuess",
    "NoiseLevel",
    "NoisePriors",
    "Problem",
    "ResidualDistortion",
    "Unknowns",
    "adjust",
    "cross_validate",
    "estimate_initial_guess",
    "estimate_residual_distortion",
    "model_systematic_errors",
    "reject_outliers",
]
