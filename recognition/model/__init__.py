"""The point chain model, the result of recognition.

Chains, crossings and grasps go in, with the parameters, the findings and the quality of the views.
The model comes out, with verdicts, Gauss code, P-data and its JSON document of schema `pointchain/2`.
"""

from recognition.model.chains import Chain, Crossing, End, StrandPoint
from recognition.model.changes import ChainMatch, ModelChanges
from recognition.model.finding_types import FINDING_TYPES, FindingCode, FindingType, Severity
from recognition.model.findings import Finding
from recognition.model.grasps import Grasp
from recognition.model.model import METHODS, SCHEMA, Method, PointChainModel
from recognition.model.provenance import Provenance
from recognition.model.quality import Quality, ViewQuality
from recognition.model.topology import CrossingElement, EndElement, PData, SegmentElement
from recognition.model.trust import ChainTrust, Verdict

__all__ = [
    "FINDING_TYPES",
    "METHODS",
    "SCHEMA",
    "Chain",
    "ChainMatch",
    "ChainTrust",
    "Crossing",
    "CrossingElement",
    "End",
    "EndElement",
    "Finding",
    "FindingCode",
    "FindingType",
    "Grasp",
    "Method",
    "ModelChanges",
    "PData",
    "PointChainModel",
    "Provenance",
    "Quality",
    "SegmentElement",
    "Severity",
    "StrandPoint",
    "Verdict",
    "ViewQuality",
]
