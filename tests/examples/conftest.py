"""Fixtures of the examples' tests: the service's, which live beside its own tests."""

from tests.service.conftest import serve

__all__ = ["serve"]
