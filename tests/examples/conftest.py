"""Fixtures for the tests of the examples, shared with the tests of the service."""

from tests.service.conftest import recording_file, serve

__all__ = ["recording_file", "serve"]
