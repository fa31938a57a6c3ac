"""The description of the API for programs and for people; with keys set, for callers who bring one."""

from fastapi import APIRouter, Depends, Request
from fastapi.openapi.docs import get_swagger_ui_html
from starlette.responses import JSONResponse, Response

from service.http.access import require_for_details

router = APIRouter(include_in_schema=False, dependencies=[Depends(require_for_details)])


@router.get("/openapi.json")
async def openapi_document(request: Request) -> Response:
    """Return the OpenAPI document."""
    return JSONResponse(request.app.openapi())


@router.get("/docs")
async def pages(request: Request) -> Response:
    """Show it."""
    return get_swagger_ui_html(openapi_url="/openapi.json", title=request.app.title)
