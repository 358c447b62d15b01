"""The JSON documents of the HTTP API, and their conversion from database rows."""
