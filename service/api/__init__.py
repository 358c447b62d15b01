"""The HTTP API: routes, their schemas, and what answers of all routes share."""
