"""Request for a recognition: the one value that HTTP, command line, batch and library give to the pipeline."""

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Self

from recognition.errors import InvalidParametersError
from recognition.grasping.gripper import Gripper
from recognition.model.model import METHODS, Method
from recognition.parameters import ChainParameters, check_settings


@dataclass(frozen=True)
class RecognitionRequest:
    """How to recognise a scan. A request may hold invalid values until `check` is called, as `recognise` does."""

    method: Method = "graph"
    """`matching` is the earlier method of the paper's authors, `enhanced` that of the paper, `graph` is ours."""
    radius_m: float | None = None
    """Radius of the strings, metres. None: it is measured, which needs all views and doubles the computing time."""
    settings: Mapping[str, float] = field(default_factory=dict)
    """Parameter values by name, which replace those for the radius. The measurement of the radius ignores them."""
    gripper: Gripper = field(default_factory=Gripper)
    """Gripper for which grasps are planned."""
    all_grasps: bool = False
    """Whether the model also has the grasps on parts of chains with a doubt."""

    def check(self) -> None:
        """Check the method, the settings and the radius.

        Raises:
            InvalidParametersError: The method is unknown, it does not use one of the settings, the radius is not the
                radius of a string, or the values break a condition of Table I.
        """
        if self.method not in METHODS:
            raise InvalidParametersError(f"there is no method {self.method!r}; it must be one of {', '.join(METHODS)}")
        check_settings(self.settings, self.method)
        if self.radius_m is not None:
            self.parameters_for(self.radius_m)

    def parameters_for(self, radius_m: float) -> ChainParameters:
        """Return the method parameters for a given or measured radius, with the settings.

        Args:
            radius_m: String radius, metres.

        Raises:
            InvalidParametersError: The radius or the settings are not accepted.
        """
        return ChainParameters.for_radius(radius_m).with_settings(self.settings)

    def or_radius(self, recorded_m: float | None) -> Self:
        """Return the request with the radius of the recording or of the configuration, if it has no radius itself.

        Args:
            recorded_m: String radius, metres. None: unknown, so that recognition measures it.

        Raises:
            InvalidParametersError: The radius is not the radius of a string.
        """
        radius_m = recorded_m if self.radius_m is None else self.radius_m
        if radius_m is None:
            return self
        return replace(self, radius_m=ChainParameters.for_radius(radius_m).r)

    @classmethod
    def from_json(cls, document: Mapping[str, Any]) -> Self:
        """Return the request of a document that `to_json` returned.

        Raises:
            pydantic.ValidationError: The document is not a request.
        """
        # Imported here, because pydantic takes a tenth of the time that `recognition` needs to load.
        from pydantic import TypeAdapter

        return TypeAdapter(cls).validate_python(document)

    def to_json(self) -> dict[str, Any]:
        """Return the request as JSON values, without `settings` and `all_grasps` if they are not set.

        A radius that is NaN or infinite becomes text. Recognition rejects it.
        """
        document = asdict(self)
        if self.radius_m is not None and not math.isfinite(self.radius_m):
            document["radius_m"] = str(self.radius_m)
        if not self.settings:
            del document["settings"]
        if not self.all_grasps:
            del document["all_grasps"]
        # Lists instead of tuples, as in a document that is read again.
        return json.loads(json.dumps(document))
