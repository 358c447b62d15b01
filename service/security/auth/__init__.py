"""Authentication and authorisation: tokens, roles, and the names by which the service may be called."""
