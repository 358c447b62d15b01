"""The HTTP API: routes, their schemas, and the parts that all routes share."""
