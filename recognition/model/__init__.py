"""The point chain model, the result of recognition.

Chains, crossings and grasps go in, with the parameters and the quality of the views.
The model comes out, with its Gauss code, its P-data and its JSON document of schema `pointchain/1`.
"""

from recognition.model.chains import Chain, Crossing, End, Grasp, StrandPoint
from recognition.model.model import METHODS, SCHEMA, Method, PointChainModel
from recognition.model.quality import Quality, ViewQuality
from recognition.model.topology import CrossingElement, EndElement, PData, SegmentElement

__all__ = [
    "METHODS",
    "SCHEMA",
    "Chain",
    "Crossing",
    "CrossingElement",
    "End",
    "EndElement",
    "Grasp",
    "Method",
    "PData",
    "PointChainModel",
    "Quality",
    "SegmentElement",
    "StrandPoint",
    "ViewQuality",
]
