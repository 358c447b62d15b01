"""The server process: uvicorn with connection limits, the event loop watchdog, and the supervisor."""
