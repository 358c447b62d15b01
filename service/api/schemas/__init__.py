"""The JSON documents of the HTTP API, and how rows become them."""
