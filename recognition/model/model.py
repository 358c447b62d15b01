"""The point chain model, the result of recognition. Metres, radians, seconds, base frame."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal, Self, TypeVar, cast

from recognition.errors import ModelError
from recognition.model.chains import Chain, Crossing
from recognition.model.changes import ModelChanges, compare_chains
from recognition.model.grasps import Grasp
from recognition.model.provenance import Provenance
from recognition.model.quality import Quality
from recognition.model.topology import PData, gauss_code, p_data
from recognition.model.trust import ChainTrust, Verdict, chain_trust, crossing_verdict
from recognition.parameters import ChainParameters

SCHEMA = "pointchain/2"
"""Name and version of the JSON document."""
Method = Literal["matching", "enhanced", "graph"]
"""Name of a method. `matching` and `enhanced` are the methods of the paper."""
_Numbered = TypeVar("_Numbered", Chain, Crossing)
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
    """The strings, in the order of `x + y / 2` of their means (see `recognition.model.canonical_order`)."""
    crossings: tuple[Crossing, ...] = ()
    """All crossings, numbered from 0."""
    quality: Quality = field(default_factory=Quality)
    """Verdict, findings and views."""
    timing_s: Mapping[str, float] = field(default_factory=dict)
    """Duration of each stage, seconds."""
    frame: str = "base"
    """Frame of all coordinates."""
    grasps: tuple[Grasp, ...] = ()
    """Grasps on all chains, first the best of each cluster, then all others. Each part is sorted by score."""
    provenance: Provenance | None = None
    """Where the model comes from. None if recognition was called as a library."""

    def to_json(self) -> dict[str, Any]:
        """Return the model as a JSON document of schema `pointchain/2`.

        All numbers are finite. Positions and lengths are rounded to a micrometre. Topology and verdicts are computed
        from the rounded numbers, so the model that `from_json` reads gives the same document.

        Raises:
            ValueError: A number of the model is not finite.
            TopologyError: The chains and the crossings contradict each other.
        """
        # Imported here, because pydantic takes a tenth of the time that `recognition` needs to load.
        from recognition.model.document import (
            ChainDocument,
            CrossingDocument,
            ModelDocument,
            p_data_document,
            parameters_document,
        )

        written = self._as_written()
        document = ModelDocument.model_validate(
            {
                "schema": SCHEMA,
                "frame": self.frame,
                "method": self.method,
                "parameters": parameters_document(self.parameters),
                "chains": [ChainDocument.of(chain, written.chain_trust(chain.id)) for chain in written.chains],
                "crossings": [CrossingDocument.of(x, written.crossing_verdict(x.id)) for x in written.crossings],
                "topology": {"gauss_code": written.gauss_code(), "p_data": p_data_document(written.p_data())},
                "grasps": self.grasps,
                "quality": written.quality,
                "timing_s": dict(self.timing_s),
                "provenance": self.provenance,
            }
        )
        return document.model_dump(mode="json", by_alias=True)

    def _as_written(self) -> Self:
        """Return the model with the rounded chains, crossings and findings of its document."""
        from recognition.model.document import ChainDocument, CrossingDocument, FindingDocument

        chains = [ChainDocument.of(chain, self.chain_trust(chain.id)) for chain in self.chains]
        crossings = [CrossingDocument.of(crossing, self.crossing_verdict(crossing.id)) for crossing in self.crossings]
        findings = [FindingDocument.model_validate(finding) for finding in self.quality.findings]
        return replace(
            self,
            chains=tuple(chain.to_chain() for chain in chains),
            crossings=tuple(crossing.to_crossing() for crossing in crossings),
            quality=replace(self.quality, findings=tuple(finding.to_finding() for finding in findings)),
        )

    @classmethod
    def from_json(cls, document: Mapping[str, Any]) -> Self:
        """Return the model of a document that `to_json` returned, accurate to a micrometre.

        Args:
            document: The document. Unknown members are ignored.

        Raises:
            recognition.errors.ModelError: The document is not a model, it has another schema, or it contradicts itself.
        """
        from pydantic import ValidationError

        from recognition.model.document import ModelDocument, parameters_from_document

        check_schema(document)
        try:
            parsed = ModelDocument.model_validate(document)
            provenance = None if parsed.provenance is None else parsed.provenance.to_provenance()
            model = cls(
                method=cast(Method, parsed.method),
                parameters=parameters_from_document(parsed.parameters),
                chains=tuple(chain.to_chain() for chain in parsed.chains),
                crossings=tuple(crossing.to_crossing() for crossing in parsed.crossings),
                quality=parsed.quality.to_quality(),
                timing_s=parsed.timing_s,
                frame=parsed.frame,
                grasps=tuple(grasp.to_grasp() for grasp in parsed.grasps),
                provenance=provenance,
            )
        except ValidationError as error:
            first = error.errors()[0]
            member = ".".join(str(part) for part in first["loc"])
            raise ModelError(f"not a point chain model: {member}: {first['msg']}") from error
        except TypeError as error:
            raise ModelError(f"not a point chain model: parameters: {error}") from error
        except (ValueError, OverflowError) as error:
            raise ModelError(f"not a point chain model: {error}") from error
        known = {chain.id for chain in model.chains}
        referred = {grasp.chain for grasp in model.grasps}
        for crossing in model.crossings:
            referred |= {crossing.over.chain, crossing.under.chain}
        for finding in model.quality.findings:
            referred |= set(finding.chains)
        if not referred <= known:
            raise ModelError(f"the model refers to chains that it does not have: {sorted(referred - known)}")
        named = {finding.crossing for finding in model.quality.findings} - {crossing.id for crossing in model.crossings}
        if missing := sorted(number for number in named if number is not None):
            raise ModelError(f"the model refers to crossings that it does not have: {missing}")
        return model

    @cached_property
    def _trusts(self) -> dict[int, ChainTrust]:
        """Trust of each chain by its id."""
        return {chain.id: chain_trust(chain, self.crossings, self.quality.findings) for chain in self.chains}

    def chain_trust(self, chain: int) -> ChainTrust:
        """Return the verdict on a chain, and its trusted parts.

        Args:
            chain: Id of the chain.

        Raises:
            KeyError: The model has no chain with this id.
        """
        return self._trusts[_with_id(self.chains, chain).id]

    def crossing_verdict(self, crossing: int) -> Verdict:
        """Return the verdict on a crossing.

        Args:
            crossing: Id of the crossing.

        Raises:
            KeyError: The model has no crossing with this id.
        """
        found = _with_id(self.crossings, crossing)
        trusts = [self.chain_trust(position.chain) for position in (found.over, found.under)]
        return crossing_verdict(found, trusts, self.quality.findings)

    def trusted(self, chain: int, s_m: float | None = None) -> bool:
        """Return whether a program may act on a chain, or on a position of a chain, without a person.

        Args:
            chain: Id of the chain.
            s_m: Arc length of the position, metres. None: the verdict on the whole chain must be `accept`.

        Raises:
            KeyError: The model has no chain with this id.
        """
        trust = self.chain_trust(chain)
        return trust.verdict == "accept" if s_m is None else trust.is_trusted(s_m)

    def since(self, before: "PointChainModel") -> ModelChanges:
        """Return which chain of an earlier model is which chain of this one, and what is new or gone.

        Args:
            before: Earlier model of the same table.
        """
        return compare_chains(before.chains, self.chains)

    def gauss_code(self) -> list[list[list[Any]]]:
        """Return for each chain the crossings along it, in order: `[crossing id, "over" or "under", sign]`."""
        return gauss_code(self.chains, self.crossings)

    def p_data(self) -> PData:
        """Return the ends, crossings and segments, and the matrix that says which follows which."""
        return p_data(self.chains, self.crossings)


def check_schema(document: Any) -> None:
    """Raise ModelError if a document names another schema than that of this version."""
    schema = document.get("schema") if isinstance(document, Mapping) else None
    if isinstance(schema, str) and schema != SCHEMA:
        raise ModelError(f"the document is of schema {schema!r}; this version of Pointchain reads {SCHEMA!r}")


def _with_id(items: Sequence[_Numbered], number: int) -> _Numbered:
    """Return the chain or the crossing with an id, or raise KeyError."""
    for item in items:
        if item.id == number:
            return item
    raise KeyError(f"the model has no item with the id {number}; it has {[item.id for item in items]}")
