"""What goes over HTTP is described by the words beside its fields."""

from pydantic import BaseModel, ConfigDict


class Described(BaseModel):
    """A document whose fields' docstrings are in the API's description, `/openapi.json`."""

    model_config = ConfigDict(use_attribute_docstrings=True)
