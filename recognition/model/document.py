"""The parts of the JSON document of a model. Positions and lengths are rounded to a micrometre."""

from dataclasses import asdict
from typing import Any

from recognition.model.chains import Chain, Crossing, Grasp, StrandPoint
from recognition.model.topology import CrossingElement, Element, EndElement, PData, SegmentElement
from recognition.parameters import ChainParameters


def parameters_document(parameters: ChainParameters) -> dict[str, float]:
    """Return the parameters with their units in the keys (`r_m`)."""
    return {name if name in ("rho_t", "R_t") else f"{name}_m": value for name, value in asdict(parameters).items()}


def chain_document(chain: Chain) -> dict[str, Any]:
    """Return the JSON document of a chain."""
    return {
        "id": chain.id,
        "closed": chain.closed,
        "radius_m": chain.radius_m,
        "length_m": round(chain.length_m, 6),
        "points": chain.points.round(6).tolist(),
        "arc_length_m": chain.arc_length_m.round(6).tolist(),
        "sigma_m": chain.sigma_m.round(6).tolist(),
        "views": chain.views.tolist(),
        "ends": list(chain.ends),
    }


def crossing_document(crossing: Crossing) -> dict[str, Any]:
    """Return the JSON document of a crossing."""
    return {
        "id": crossing.id,
        "point": crossing.point.round(6).tolist(),
        "over": _strand_point_document(crossing.over),
        "under": _strand_point_document(crossing.under),
        "gap_m": round(crossing.gap_m, 6),
        "angle_rad": round(crossing.angle_rad, 6),
        "sign": crossing.sign,
        "confidence": round(crossing.confidence, 4),
    }


def grasp_document(grasp: Grasp) -> dict[str, Any]:
    """Return the JSON document of a grasp."""
    T = grasp.T_base_grasp.round(9)
    T[:3, 3] = T[:3, 3].round(6)
    T += 0.0  # turns -0.0 into 0.0
    return {
        "chain": grasp.chain,
        "s_m": round(grasp.s_m, 6),
        "T_base_grasp": T.tolist(),
        "opening_m": round(grasp.opening_m, 6),
        "reach_m": round(grasp.reach_m, 6),
        "clearance_m": round(grasp.clearance_m, 6),
        "table_clearance_m": round(grasp.table_clearance_m, 6),
        "score": round(grasp.score, 4),
    }


def p_data_document(p_data: PData) -> dict[str, Any]:
    """Return the JSON document of P-data: `{"elements": [...], "matrix": [[...]]}`."""
    elements = [{"id": number} | _element_document(element) for number, element in enumerate(p_data.elements)]
    return {"elements": elements, "matrix": p_data.matrix.tolist()}


def _strand_point_document(position: StrandPoint) -> dict[str, Any]:
    return {"chain": position.chain, "s_m": round(position.s_m, 6)}


def _element_document(element: Element) -> dict[str, Any]:
    match element:
        case EndElement():
            return {
                "kind": "end",
                "chain": element.chain,
                "which": element.which,
                "s_m": round(element.s_m, 6),
                "end": element.end,
            }
        case CrossingElement():
            return {
                "kind": "crossing",
                "crossing": element.crossing,
                "sign": element.sign,
                "over": _strand_point_document(element.over),
                "under": _strand_point_document(element.under),
            }
        case SegmentElement():
            return {"kind": "segment", "chain": element.chain, "s_m": [round(s, 6) for s in element.s_m]}
