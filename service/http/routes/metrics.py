"""Metrics for Prometheus."""

from fastapi import APIRouter, Depends, Request
from prometheus_client import CONTENT_TYPE_LATEST
from starlette.responses import Response

from service.http.access import require_for_details
from service.problems import error_responses
from service.services import services_of

router = APIRouter(tags=["operations"])


@router.get(
    "/metrics",
    summary="Metrics for Prometheus",
    dependencies=[Depends(require_for_details)],
    response_class=Response,
    responses={
        200: {"description": "Prometheus text format.", "content": {"text/plain": {"schema": {"type": "string"}}}},
        **error_responses(401, 403, 429),
    },
)
async def metrics(request: Request) -> Response:
    """Return requests, stages, queue, workers, index loads and resident bytes."""
    return Response(services_of(request).metrics.text(), headers={"Content-Type": CONTENT_TYPE_LATEST})
