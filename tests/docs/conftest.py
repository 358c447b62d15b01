"""Fixtures for the tests of the documents, shared with the tests of the service."""

from tests.service.conftest import fork_server, serve

__all__ = ["fork_server", "serve"]
