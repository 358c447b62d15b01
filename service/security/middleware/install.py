"""Add the security middleware to an application, in its order."""

from typing import Any

from fastapi import FastAPI

from service.config.loader import ServiceConfig
from service.security.audit.log import AuditLog
from service.security.auth.allowed_hosts import AllowedHosts, is_loopback
from service.security.auth.authentication import Authenticator
from service.security.auth.code_sign_in import CodeSignIn
from service.security.auth.roles import Call, find_call
from service.security.auth.sessions import SessionFile
from service.security.auth.tokens import TokenFile
from service.security.middleware.audit_recorder import AuditMiddleware
from service.security.middleware.body_limits import BodyLimits, BodyTimeouts
from service.security.middleware.gate import Gate
from service.security.middleware.headers import SecurityHeaders

SCHEME = {
    "type": "http",
    "scheme": "bearer",
    "description": "A token of `pointchain token add`. Without any token, everybody on the service's own machine may "
    "do everything.",
}


def install_security(app: FastAPI, config: ServiceConfig, audit: AuditLog, upload_path: str) -> None:
    """Add the middleware. From outside to inside: headers of the answer, audit log, gate, limits of the body.

    Args:
        app: The application.
        config: The configuration.
        audit: The audit log.
        upload_path: Path of the uploads, whose bodies have their own limits.
    """
    # The middleware that is added last is the outermost.
    app.add_middleware(
        BodyLimits,
        request_bytes=config.limits.request_bytes,
        upload_bytes=config.limits.upload_bytes,
        upload_path=upload_path,
        timeouts=BodyTimeouts(),
    )
    tokens, sessions = TokenFile(config.data_dir), SessionFile(config.data_dir)
    app.state.authenticator = authenticator = Authenticator(tokens, sessions, is_loopback(config.host))
    app.state.code_sign_in = CodeSignIn(config.data_dir)
    hosts = AllowedHosts(config.host, config.security.allowed_hosts)
    app.add_middleware(Gate, authenticator=authenticator, hosts=hosts)
    app.add_middleware(AuditMiddleware, audit=audit)
    app.add_middleware(SecurityHeaders)
    _describe_roles(app)


def _describe_roles(app: FastAPI) -> None:
    """Add the minimum role of each call, and the security scheme, to the description of the API."""
    original = app.openapi

    def openapi() -> dict[str, Any]:
        if app.openapi_schema is None:
            document = original()
            document.setdefault("components", {})["securitySchemes"] = {"token": SCHEME}
            for path, item in document["paths"].items():
                for method, operation in item.items():
                    call = find_call(method.upper(), path)
                    if isinstance(call, Call) and call.min_role is not None:
                        # The empty requirement stands for a service without tokens.
                        operation["security"] = [{"token": []}, {}]
                        operation["x-min-role"] = call.min_role
        return app.openapi_schema or original()

    app.openapi = openapi
