"""Fixtures for the tests of the documents, shared with the tests of the service."""

from tests.service.conftest import serve

__all__ = ["serve"]
