"""Convert the JSON document of a point chain model back to arrays."""

from collections.abc import Mapping
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from recognition.errors import RecognitionError
from recognition.model.chains import Chain, Crossing, Grasp, StrandPoint
from recognition.model.model import Method, PointChainModel, Quality, ViewQuality
from recognition.parameters import ChainParameters
from service.model_schema import (
    ChainDocument,
    CrossingDocument,
    GraspDocument,
    ModelDocument,
    QualityDocument,
    StrandPointDocument,
)


class ModelError(ValueError):
    """The document is not a model of schema `pointchain/1`."""


def model_from_json(document: Mapping[str, Any]) -> PointChainModel:
    """Return the model of a document that `PointChainModel.to_json` wrote, accurate to a micrometre.

    Args:
        document: The document. Unknown members are ignored.

    Raises:
        ModelError: The document is not a model, or it contradicts itself.
    """
    try:
        parsed = ModelDocument.model_validate(document)
        # A number's key has its unit, which the field has not.
        parameters = ChainParameters(**{key.removesuffix("_m"): value for key, value in parsed.parameters.items()})
    except ValidationError as error:
        raise ModelError(f"not a point chain model: {error.errors()[0]['loc']}: {error.errors()[0]['msg']}") from error
    except (RecognitionError, TypeError) as error:
        raise ModelError(f"the model's parameters cannot be: {error}") from error
    model = PointChainModel(
        cast(Method, parsed.method),
        parameters,
        tuple(map(_chain, parsed.chains)),
        tuple(map(_crossing, parsed.crossings)),
        _quality(parsed.quality),
        dict(parsed.timing_s),
        parsed.frame,
        tuple(map(_grasp, parsed.grasps)),
    )
    _check(model)
    return model


def _chain(chain: ChainDocument) -> Chain:
    points, sigma_m = _array(chain.points, "points").reshape(-1, 3), _array(chain.sigma_m, "sigma_m")
    if not len(points) == len(sigma_m) == len(chain.views):
        raise ModelError(
            f"chain {chain.id} has {len(points)} points, {len(sigma_m)} sigmas and {len(chain.views)} counts of views: "
            "as many of each are needed"
        )
    views = np.asarray(chain.views, dtype=np.int64)
    return Chain(chain.id, chain.closed, chain.radius_m, points, sigma_m, views, chain.ends)


def _crossing(crossing: CrossingDocument) -> Crossing:
    return Crossing(
        crossing.id,
        _array(crossing.point, "point"),
        _place(crossing.over),
        _place(crossing.under),
        crossing.gap_m,
        crossing.angle_rad,
        crossing.sign,
        crossing.confidence,
    )


def _grasp(grasp: GraspDocument) -> Grasp:
    return Grasp(
        grasp.chain,
        grasp.s_m,
        _array(grasp.T_base_grasp, "T_base_grasp"),
        grasp.opening_m,
        grasp.reach_m,
        grasp.clearance_m,
        grasp.table_clearance_m,
        grasp.score,
    )


def _quality(quality: QualityDocument) -> Quality:
    views = [
        ViewQuality(
            view.index,
            view.used,
            view.reason,
            view.points,
            view.fitness,
            view.rms_m,
            view.correction_m,
            view.correction_rad,
        )
        for view in quality.views
    ]
    return Quality(tuple(views), tuple(quality.ambiguities), tuple(quality.warnings))


def _place(place: StrandPointDocument) -> StrandPoint:
    return StrandPoint(place.chain, place.s_m)


def _array(values: Any, name: str) -> NDArray[np.float64]:
    array = np.asarray(values, dtype=np.float64)
    if not np.isfinite(array).all():
        raise ModelError(f"{name} of the model is not finite")
    return array


def _check(model: PointChainModel) -> None:
    known = {chain.id for chain in model.chains}
    named = {place.chain for crossing in model.crossings for place in (crossing.over, crossing.under)}
    named |= {grasp.chain for grasp in model.grasps}
    if not named <= known:
        raise ModelError(f"the model names chains that it does not have: {sorted(named - known)}")
