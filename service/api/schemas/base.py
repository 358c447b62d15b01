"""Base class of the HTTP API's documents."""

from pydantic import BaseModel, ConfigDict


class ApiModel(BaseModel):
    """A document whose field docstrings become descriptions in `/openapi.json`."""

    model_config = ConfigDict(use_attribute_docstrings=True)


class RequestModel(ApiModel):
    """The body of a request. A member that does not exist is refused: a misspelt one would otherwise have no effect."""

    model_config = ConfigDict(extra="forbid")
