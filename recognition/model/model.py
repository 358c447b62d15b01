"""The point chain model, the result of recognition. Metres, radians, seconds, base frame."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, Self, cast

from recognition.errors import ModelError
from recognition.model.chains import Chain, Crossing, Grasp
from recognition.model.quality import Quality
from recognition.model.topology import PData, gauss_code, p_data
from recognition.parameters import ChainParameters

SCHEMA = "pointchain/1"
"""Name and version of the JSON document."""
Method = Literal["matching", "enhanced", "graph"]
"""Name of a method. `matching` and `enhanced` are the methods of the paper."""
METHODS: tuple[Method, ...] = ("matching", "enhanced", "graph")
"""All methods."""


@dataclass(frozen=True, eq=False)
class PointChainModel:
    """All strings of a scene, with their crossings and grasps.

    The fields have the names of the JSON document, with two differences. The document has `topology` in place of
    `gauss_code()` and `p_data()`. The names of its parameters have a unit (`r_m` in place of `r`).
    """

    method: Method
    """Method that made the model (`matching`, `enhanced` or `graph`)."""
    parameters: ChainParameters
    """Parameters that were used."""
    chains: tuple[Chain, ...] = ()
    """The strings, the longest first."""
    crossings: tuple[Crossing, ...] = ()
    """All crossings, numbered from 0."""
    quality: Quality = field(default_factory=Quality)
    """Views, ambiguities and warnings."""
    timing_s: Mapping[str, float] = field(default_factory=dict)
    """Duration of each stage, seconds."""
    frame: str = "base"
    """Frame of all coordinates."""
    grasps: tuple[Grasp, ...] = ()
    """Grasps on all chains, the best first."""

    def to_json(self) -> dict[str, Any]:
        """Return the model as a JSON document of schema `pointchain/1`.

        All numbers are finite. Positions and lengths are rounded to a micrometre.

        Raises:
            ValueError: A number of the model is not finite.
            TopologyError: The chains and the crossings contradict each other.
        """
        # Imported here, because pydantic takes a tenth of the time that `recognition` needs to load.
        from recognition.model.document import ModelDocument, p_data_document, parameters_document

        document = ModelDocument.model_validate(
            {
                "schema": SCHEMA,
                "frame": self.frame,
                "method": self.method,
                "parameters": parameters_document(self.parameters),
                "chains": self.chains,
                "crossings": self.crossings,
                "topology": {"gauss_code": self.gauss_code(), "p_data": p_data_document(self.p_data())},
                "grasps": self.grasps,
                "quality": self.quality,
                "timing_s": dict(self.timing_s),
            }
        )
        return document.model_dump(mode="json", by_alias=True)

    @classmethod
    def from_json(cls, document: Mapping[str, Any]) -> Self:
        """Return the model of a document that `to_json` returned, accurate to a micrometre.

        Args:
            document: The document. Unknown members are ignored.

        Raises:
            ModelError: The document is not a model, or it contradicts itself.
        """
        from pydantic import ValidationError

        from recognition.model.document import ModelDocument, parameters_from_document

        try:
            parsed = ModelDocument.model_validate(document)
            model = cls(
                method=cast(Method, parsed.method),
                parameters=parameters_from_document(parsed.parameters),
                chains=tuple(chain.to_chain() for chain in parsed.chains),
                crossings=tuple(crossing.to_crossing() for crossing in parsed.crossings),
                quality=parsed.quality.to_quality(),
                timing_s=parsed.timing_s,
                frame=parsed.frame,
                grasps=tuple(grasp.to_grasp() for grasp in parsed.grasps),
            )
        except ValidationError as error:
            first = error.errors()[0]
            member = ".".join(str(part) for part in first["loc"])
            raise ModelError(f"not a point chain model: {member}: {first['msg']}") from error
        except TypeError as error:
            raise ModelError(f"not a point chain model: parameters: {error}") from error
        except ValueError as error:
            raise ModelError(f"not a point chain model: {error}") from error
        known = {chain.id for chain in model.chains}
        referred = {position.chain for crossing in model.crossings for position in (crossing.over, crossing.under)}
        referred |= {grasp.chain for grasp in model.grasps}
        if not referred <= known:
            raise ModelError(f"the model refers to chains that it does not have: {sorted(referred - known)}")
        return model

    def gauss_code(self) -> list[list[list[Any]]]:
        """Return for each chain the crossings along it, in order: `[crossing id, "over" or "under", sign]`."""
        return gauss_code(self.chains, self.crossings)

    def p_data(self) -> PData:
        """Return the ends, crossings and segments, and the matrix that says which follows which."""
        return p_data(self.chains, self.crossings)
