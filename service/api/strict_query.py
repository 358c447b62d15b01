"""Rejection of unknown query parameters, as in bodies and in the configuration.

A misspelt filter would otherwise be ignored, and everything would be listed.
"""

from fastapi import Request
from fastapi.dependencies.utils import get_flat_params
from fastapi.exceptions import RequestValidationError
from fastapi.params import Query


async def reject_unknown_parameters(request: Request) -> None:
    """Reject a request whose query has a parameter that its route does not declare.

    Raises:
        RequestValidationError: The query has an unknown parameter.
    """
    if not request.scope["query_string"]:
        return
    params = get_flat_params(request.scope["route"].dependant)
    declared = [field.alias for field in params if isinstance(field.field_info, Query)]
    unknown = request.query_params.keys() - set(declared)
    if unknown:
        accepted = f"use {', '.join(declared)}" if declared else "there is none at this address"
        message = f"there is no such parameter; {accepted}"
        raise RequestValidationError([{"loc": ("query", name), "msg": message} for name in sorted(unknown)])
