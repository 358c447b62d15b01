"""Routes of the OpenAPI document and of its page, Swagger UI from local files.

The page has no inline script, because its content security policy forbids that.
"""

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
# browsers send no Sec-Fetch-Site over plain HTTP away from loopback; the header shows that no other page is calling
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

_GENERATING = threading.Lock()
"""Lock for generating the OpenAPI document, which is incomplete until it is done."""
router = APIRouter(include_in_schema=False)


@router.get(DOCS)
async def page() -> HTMLResponse:
    """Return the page on which a person can read and try out the API."""
    return HTMLResponse(PAGE)


@router.get(START)
async def start() -> Response:
    """Return the script that starts the page."""
    return Response(SCRIPT, media_type="text/javascript")


@router.get(DESCRIPTION)
async def description(request: Request, service: Service) -> Response:
    """Return the OpenAPI document.

    A thread generates it at the first request, because that takes most of a second, and no stop must wait for it.
    """

    def generate() -> Response:
        with _GENERATING:
            return Response(json.dumps(request.app.openapi()), media_type="application/json")

    return await service.response_cache.respond(DESCRIPTION, generate)
