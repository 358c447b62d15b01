"""Route of the metrics for Prometheus."""

from fastapi import APIRouter, Request, Response
from prometheus_client.exposition import CONTENT_TYPE_PLAIN_0_0_4

from service.api.problem_responses import problem_responses

router = APIRouter(tags=["health"])

TEXT = {200: {"content": {"text/plain": {"schema": {"type": "string"}}}}}


@router.get("/metrics", response_class=Response, responses=TEXT | problem_responses())
def get_metrics(request: Request) -> Response:
    """Return metrics of scans, recognition, stops, cell state, requests and disk in the text format of Prometheus."""
    return Response(request.app.state.metrics.text(), media_type=CONTENT_TYPE_PLAIN_0_0_4)
