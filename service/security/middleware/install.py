"""Puts all of this around an application, in its order."""

from typing import Any

from fastapi import FastAPI

from service.config.loader import ServiceConfig
from service.security.audit.log import AuditLog
from service.security.auth.allowed_hosts import AllowedHosts, is_loopback
from service.security.auth.authentication import Callers
from service.security.auth.roles import Call, find_call
from service.security.auth.tokens import TokenFile
from service.security.middleware.audit_recorder import Recorder
from service.security.middleware.body_limits import BodyLimits, Patience
from service.security.middleware.gate import Gate
from service.security.middleware.headers import SecurityHeaders

SCHEME = {
    "type": "http",
    "scheme": "bearer",
    "description": "A token of `pointchain token add`. Without any token, everybody on the service's own machine may "
    "do everything.",
}


def install_security(app: FastAPI, config: ServiceConfig, audit: AuditLog, upload_path: str) -> None:
    """Adds the middleware. From outside to inside: headers of the answer, the record, the gate, the body's limits."""
    # Starlette puts what is added last outermost.
    app.add_middleware(
        BodyLimits,
        request_bytes=config.limits.request_bytes,
        upload_bytes=config.limits.upload_bytes,
        upload_path=upload_path,
        patience=Patience(),
    )
    app.state.callers = callers = Callers(TokenFile(config.data_dir), is_loopback(config.host))
    app.add_middleware(Gate, callers=callers, hosts=AllowedHosts(config.host, config.security.allowed_hosts))
    app.add_middleware(Recorder, audit=audit)
    app.add_middleware(SecurityHeaders)
    _describe(app)


def _describe(app: FastAPI) -> None:
    """Has the API's description say which role each call needs, and gives its page a place for the token."""
    plain = app.openapi

    def described() -> dict[str, Any]:
        if app.openapi_schema is None:
            document = plain()
            document.setdefault("components", {})["securitySchemes"] = {"token": SCHEME}
            for path, item in document["paths"].items():
                for method, operation in item.items():
                    call = find_call(method.upper(), path)
                    if isinstance(call, Call) and call.least is not None:
                        # The empty one: nobody has to say who he is while there is no token.
                        operation["security"] = [{"token": []}, {}]
                        operation["x-least-role"] = call.least
        return app.openapi_schema or plain()

    app.openapi = described
