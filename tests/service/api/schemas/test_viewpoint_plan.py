"""The JSON document of a viewpoint plan is complete."""

from typing import Any

import numpy as np
import pytest

from cell.planning.viewpoints import Leg, Viewpoint, ViewpointPlan
from recognition.preprocessing.coverage import Coverage
from service.api.schemas.viewpoint_plan import PlanDocument

Q_RAD = np.array([0.1, -1.2, 1.3, -1.4, -1.5, 0.6])


def viewpoint(index: int, **values: Any) -> Viewpoint:
    return Viewpoint(index, 0.5, 1.1, 0.42, 0.1, np.eye(4), np.eye(4), **values)


@pytest.mark.parametrize(("held_out", "first"), [((), (0,)), ((1,), ())])
def test_the_document_has_every_member_of_the_plan(held_out: tuple[int, ...], first: tuple[int, ...]) -> None:
    plan = ViewpointPlan(
        viewpoints=(
            viewpoint(0, q_rad=Q_RAD, reason=None, fallback="10 degrees lower"),
            viewpoint(1, q_rad=None, reason="out of the arm's reach", fallback=None),
        ),
        legs=(
            Leg(0, np.array([Q_RAD, Q_RAD + 0.1]), 0.1, 0.6, np.array([Q_RAD]), 0.7),
            Leg(None, np.array([Q_RAD]), 0.1, 0.5, np.zeros((0, 6)), 0.0),
        ),
        start_q_rad=Q_RAD,
        home_q_rad=Q_RAD,
        travel_rad=0.2,
        duration_s=1.1,
        coverage=Coverage((0.3, 0.5), (-0.1, 0.1), np.array([[0, 0], [3, 4]])),
        planning_s=0.25,
        first=first,
        held_out=held_out,
        warnings=("all turns are about one axis",),
    )
    assert PlanDocument.model_validate(plan.to_json()).model_dump() == plan.to_json()
    assert plan.to_json()["early_duration_s"] == (pytest.approx(0.6 + 0.7) if first else None)
