"""The ASGI middleware of the service, from the headers of the answer to the limits of the body."""
