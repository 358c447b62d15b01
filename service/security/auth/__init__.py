"""Authentication and authorisation: tokens, roles, and the host names by which the service may be called."""
