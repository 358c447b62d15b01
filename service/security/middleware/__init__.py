"""Middleware that checks each request before a route sees it."""
