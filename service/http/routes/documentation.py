"""The description of the API for programs and for people; with keys set, for callers who bring one."""

from fastapi import APIRouter, Depends, Request
from starlette.responses import HTMLResponse, JSONResponse, Response

from service.http.access import require_for_details
from service.http.api_page import HEADERS, api_page

router = APIRouter(include_in_schema=False, dependencies=[Depends(require_for_details)])


@router.get("/openapi.json")
async def openapi_document(request: Request) -> Response:
    """Return the OpenAPI document."""
    return JSONResponse(request.app.openapi())


@router.get("/docs")
async def page(request: Request) -> Response:
    """Show it."""
    return HTMLResponse(api_page(request.app.openapi()), headers=HEADERS)
