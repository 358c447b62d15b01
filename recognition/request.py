"""Request for a recognition: the one value that HTTP, command line, batch and library give to the pipeline."""

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cache
from typing import TYPE_CHECKING, Any, Self

from recognition.errors import InvalidParametersError
from recognition.grasping.gripper import Gripper
from recognition.model.model import METHODS, Method
from recognition.parameters import ChainParameters, check_settings

if TYPE_CHECKING:
    from pydantic import TypeAdapter


@dataclass(frozen=True)
class RecognitionRequest:
    """How to recognise a scan. A request may hold invalid values until `check` is called, as `recognise` does."""

    method: Method = "graph"
    """`matching` is the earlier method of the paper's authors, `enhanced` that of the paper, `graph` is ours."""
    radius_m: float | None = None
    """Radius of the strings, metres. None means that it is measured, which needs all views and doubles the time."""
    settings: Mapping[str, float] = field(default_factory=dict)
    """Parameter values by name, which replace those for the radius. The measurement of the radius ignores them."""
    gripper: Gripper = field(default_factory=Gripper)
    """Gripper for which grasps are planned."""
    all_grasps: bool = False
    """Whether the model also has the grasps on parts of chains with a doubt."""

    def check(self) -> None:
        """Check all values.

        Raises:
            InvalidParametersError: The method is unknown, it does not use one of the settings, the radius is not the
                radius of a string, the values break a condition of Table I, or a value has another type.
        """
        if not isinstance(self.settings, Mapping):
            raise InvalidParametersError(f"settings is {self.settings!r}; values by parameter name are needed, or {{}}")
        if not isinstance(self.gripper, Gripper):
            raise InvalidParametersError(f"gripper is {self.gripper!r}; a Gripper is needed")
        if not isinstance(self.all_grasps, bool):
            raise InvalidParametersError(f"all_grasps is {self.all_grasps!r}; True or False is needed")
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
    def from_json(cls, document: Mapping[str, Any]) -> "RecognitionRequest":
        """Return the request of a document that `to_json` returned for a valid request.

        Raises:
            InvalidParametersError: A member is unknown, or has another type.
        """
        from pydantic import ValidationError

        names = [member.name for member in fields(cls)]
        for name in document:
            if name not in names:
                raise InvalidParametersError(f"a request has no member {name!r}; its members are {', '.join(names)}")
        try:
            return _validator().validate_python(document)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            member = ".".join(str(part) for part in first["loc"])
            raise InvalidParametersError(
                f"a request cannot have {member} {first['input']!r}: {first['msg']}"
            ) from error

    def to_json(self) -> dict[str, Any]:
        """Return the request as JSON values, without `settings` and `all_grasps` if they are not set.

        A radius or a setting that is NaN or infinite becomes text. Recognition rejects it.
        """
        document = asdict(self)
        document["radius_m"] = _json_number(self.radius_m)
        document["settings"] = {name: _json_number(value) for name, value in self.settings.items()}
        if not self.settings:
            del document["settings"]
        if not self.all_grasps:
            del document["all_grasps"]
        # Lists instead of tuples, as in a document that is read again.
        return json.loads(json.dumps(document))


@cache
def _validator() -> "TypeAdapter[RecognitionRequest]":
    """Return the validator of documents. It is kept, because a list of scans reads a hundred requests."""
    # Imported here, because pydantic takes a tenth of the time that `recognition` needs to load.
    from pydantic import TypeAdapter

    return TypeAdapter(RecognitionRequest)


def _json_number(value: float | None) -> float | str | None:
    """Return a number as JSON has it. NaN and infinity become text. None stays None."""
    is_json_number = value is None or math.isfinite(value)
    return value if is_json_number else str(value)
