"""A table that is not where it is given: its finding, and results from the frame in which it is to the base frame."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.transforms import transform_points
from recognition.messages import format_position
from recognition.model.chains import Chain
from recognition.model.findings import Finding, finding
from recognition.model.grasps import Grasp
from recognition.model.model import PointChainModel
from recognition.preprocessing.height_map import HeightMap
from recognition.registration.measured_table import MAX_SIGMA, MeasuredTable, describe_table
from recognition.registration.registration import Registration, transform_cloud
from recognition.registration.table_error import estimate_table_error

MIN_PROBABILITY = 0.5
"""Minimum probability that the given table is off, for a note."""


def table_findings(table: MeasuredTable | None, chains: Sequence[Chain]) -> list[Finding]:
    """Return the finding on a table that is not, or may not be, where it is given; none if the views agree with it.

    A table that is not where it is given is a doubt that concerns all chains. One that probably is not is a note,
    because `sigma_m` contains its error.

    Args:
        table: Where the views show the table; None if no view shows it.
        chains: Chains of the model.
    """
    if table is None:
        return []
    if table.is_elsewhere:
        message = (
            f"{describe_table(table)}; heights were measured from the table as the views show it: correct table_z_m or "
            "level the table; if the table is where it is given, calibrate"
        )
        ids = [chain.id for chain in chains]
        return [finding("table-elsewhere", message, chains=ids, value=table.distance_sigma, limit=MAX_SIGMA)]
    probability = estimate_table_error(table).probability
    if probability <= MIN_PROBABILITY:
        return []
    message = (
        f"{describe_table(table)}, which errors of the poses hardly explain: the given table was used, and sigma_m "
        "contains this difference; measure table_z_m again, or verify the calibration"
    )
    return [finding("table-uncertain", message, value=probability, limit=MIN_PROBABILITY)]


def move_registration(registration: Registration, T: NDArray[np.float64]) -> Registration:
    """Return the registered views after the motion `T` (4, 4), metres."""
    rotation = np.kron(np.eye(2 * len(registration.clouds)), T[:3, :3])
    return replace(
        registration,
        points=transform_points(T, registration.points),
        normals=registration.normals @ T[:3, :3].T,
        clouds=tuple(transform_cloud(cloud, T) for cloud in registration.clouds),
        centre=transform_points(T, registration.centre[None])[0],
        covariance=rotation @ registration.covariance @ rotation.T,
    )


def move_heights(heights: HeightMap, T: NDArray[np.float64]) -> HeightMap:
    """Return the height map after the small motion `T` (4, 4), metres. Its cells keep their positions."""
    centres = heights.cell_centres()
    raised = (T[2, 0] * centres[..., 0] + T[2, 1] * centres[..., 1] + T[2, 3]).astype(np.float32)
    return replace(heights, z_m=heights.z_m * np.float32(T[2, 2]) + raised)


def move_model(model: PointChainModel, T: NDArray[np.float64]) -> PointChainModel:
    """Return the model after the motion `T` (4, 4), metres."""
    findings = tuple(_move_finding(found, T) for found in model.quality.findings)
    return replace(
        model,
        chains=tuple(replace(chain, points=transform_points(T, chain.points)) for chain in model.chains),
        crossings=tuple(replace(x, point=transform_points(T, x.point[None])[0]) for x in model.crossings),
        quality=replace(model.quality, findings=findings),
        grasps=tuple(_move_grasp(grasp, T) for grasp in model.grasps),
    )


def _move_finding(found: Finding, T: NDArray[np.float64]) -> Finding:
    """Return the finding with its moved position, also in its message."""
    if found.point_m is None:
        return found
    before = np.array(found.point_m)
    after = transform_points(T, before[None])[0]
    x, y, z = after.tolist()
    message = found.message.replace(format_position(before), format_position(after))
    return replace(found, point_m=(x, y, z), message=message)


def _move_grasp(grasp: Grasp, T: NDArray[np.float64]) -> Grasp:
    motion = grasp.T_base_flange
    motion = replace(motion, pregrasp=T @ motion.pregrasp, grasp=T @ motion.grasp, retreat=T @ motion.retreat)
    return replace(grasp, T_base_grasp=T @ grasp.T_base_grasp, T_base_flange=motion)
