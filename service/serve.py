"""`pointchain serve`: the HTTP service in front of a socket."""

import sys

import uvicorn

from service.app import create_app
from service.config import ServiceConfig
from service.data_folder import DataFolder, DataFolderError

KEEP_ALIVE_S = 75
"""How long an idle connection stays open: a client that asks every few seconds must not meet one that is just being
closed, as with uvicorn's own 5 s."""


def serve(config: ServiceConfig) -> int:
    """Serves until SIGINT or SIGTERM; 0 when it ended in order, 1 when it could not start."""
    try:
        # Taken for a moment: inside the server the same refusal would come as a traceback.
        DataFolder(config.data_dir).close()
    except DataFolderError as error:
        print(f"pointchain serve: {error}", file=sys.stderr)
        return 1
    print(f"pointchain: http://{config.host}:{config.port}/docs, data in {config.data_dir}", file=sys.stderr)
    server = uvicorn.Server(
        uvicorn.Config(
            create_app(config),
            host=config.host,
            port=config.port,
            timeout_graceful_shutdown=5,
            timeout_keep_alive=KEEP_ALIVE_S,
        )
    )
    server.run()
    return 0 if server.started else 1
