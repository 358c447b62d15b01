"""The API's description, and its page: Swagger UI from local files. No script is inside the page: its content policy
forbids that."""

import json
import threading

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse, Response

from service.api.dependencies import Service
from service.security.auth.roles import DOCS, DOCS_FILES

START = f"{DOCS}/start.js"
DESCRIPTION = "/openapi.json"

PAGE = f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>Pointchain</title>
<link rel="stylesheet" href="{DOCS_FILES}/swagger-ui.css">
<link rel="icon" href="{DOCS_FILES}/favicon.png">
</head>
<body>
<div id="swagger-ui"></div>
<script src="{DOCS_FILES}/swagger-ui-bundle.js"></script>
<script src="{START}"></script>
</body>
</html>
"""
# Over plain HTTP, away from loopback, browsers send no Sec-Fetch-Site: the header says that no other page is calling.
SCRIPT = """SwaggerUIBundle({
  url: "DESCRIPTION",
  dom_id: "#swagger-ui",
  layout: "BaseLayout",
  deepLinking: true,
  showExtensions: true,
  showCommonExtensions: true,
  tryItOutEnabled: true,
  presets: [SwaggerUIBundle.presets.apis],
  requestInterceptor: (request) => {
    request.headers["X-Pointchain"] = "docs";
    return request;
  },
});
""".replace("DESCRIPTION", DESCRIPTION)

_MAKING = threading.Lock()
"""Of the description, which is only whole when it is done."""
router = APIRouter(include_in_schema=False)


@router.get(DOCS)
async def page() -> HTMLResponse:
    """What can be asked of the service, to read and to try out."""
    return HTMLResponse(PAGE)


@router.get(START)
async def start() -> Response:
    """What the page begins with."""
    return Response(SCRIPT, media_type="text/javascript")


@router.api_route(DESCRIPTION, methods=["GET", "HEAD"])
async def description(request: Request, service: Service) -> Response:
    """What can be asked of the service, for programs. Made by a thread when it is first asked for: it takes most of a
    second, for which no stop shall wait."""

    def make() -> Response:
        with _MAKING:
            return Response(json.dumps(request.app.openapi()), media_type="application/json")

    return await service.reading.answer(DESCRIPTION, make)
