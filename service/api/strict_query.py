"""A parameter of a query that nobody knows is refused, as in bodies and in the configuration: behind a misspelt filter
all would be listed."""

from fastapi import Request
from fastapi.dependencies.utils import get_flat_params
from fastapi.exceptions import RequestValidationError
from fastapi.params import Query


async def refuse_unknown(request: Request) -> None:
    """Raises RequestValidationError."""
    if not request.scope["query_string"]:
        return
    params = get_flat_params(request.scope["route"].dependant)
    known = [field.alias for field in params if isinstance(field.field_info, Query)]
    unknown = request.query_params.keys() - set(known)
    if unknown:
        there_is = f"there are {', '.join(known)}" if known else "there is none at this address"
        message = f"there is no such parameter; {there_is}"
        raise RequestValidationError([{"loc": ("query", name), "msg": message} for name in sorted(unknown)])
