"""The server process: uvicorn, its connections, its supervisor, and the watch over its event loop."""
