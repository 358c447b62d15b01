"""The page of the API: Swagger UI from local files. No script is inside the page: its content policy forbids that."""

from fastapi import APIRouter
from fastapi.responses import HTMLResponse, Response

from service.security.headers import DOCS
from service.security.roles import DOCS_FILES

START = f"{DOCS}/start.js"

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
  url: "/openapi.json",
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
"""

router = APIRouter(include_in_schema=False)


@router.get(DOCS)
async def page() -> HTMLResponse:
    """What can be asked of the service, to read and to try out."""
    return HTMLResponse(PAGE)


@router.get(START)
async def start() -> Response:
    """What the page begins with."""
    return Response(SCRIPT, media_type="text/javascript")
