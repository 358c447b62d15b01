"""Rejection of unknown and of repeated query parameters, and of JSON that is not UTF-8.

A misspelt filter would otherwise be ignored, and everything would be listed. Of two values, only one would count.
"""

import json
from collections.abc import Sequence
from typing import get_origin

from fastapi import HTTPException, Request
from fastapi.dependencies.utils import get_flat_params
from fastapi.exceptions import RequestValidationError
from fastapi.params import Query


async def reject_unfit_parameters(request: Request) -> None:
    """Reject a request whose query has a parameter that its route does not declare, or a parameter twice.

    A parameter that is declared as a sequence may be given several times.

    Raises:
        RequestValidationError: The query has such a parameter.
    """
    if not request.scope["query_string"]:
        return
    params = get_flat_params(request.scope["route"].dependant)
    declared = {field.alias: field for field in params if isinstance(field.field_info, Query)}
    accepted = f"use {', '.join(declared)}" if declared else "there is none at this address"
    errors = []
    for name in sorted(request.query_params.keys()):
        if name not in declared:
            errors.append({"loc": ("query", name), "msg": f"there is no such parameter; {accepted}"})
        elif get_origin(declared[name].field_info.annotation) is not Sequence:
            count = len(request.query_params.getlist(name))
            if count > 1:
                errors.append({"loc": ("query", name), "msg": f"is given {count} times; give it once"})
    if errors:
        raise RequestValidationError(errors)


async def reject_other_encodings(request: Request) -> None:
    """Reject a JSON body that is not UTF-8, as RFC 8259 requires. Python's `json` would read UTF-16 and UTF-32.

    Raises:
        HTTPException: 400: The body is in another encoding.
    """
    if request.scope["route"].body_field is None:  # such a body is not JSON, and may be huge
        return
    encoding = json.detect_encoding(await request.body())
    if not encoding.startswith("utf-8"):
        raise HTTPException(400, f"the body is {encoding.upper()}: JSON must be UTF-8 (RFC 8259)")
