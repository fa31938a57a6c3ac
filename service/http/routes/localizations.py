"""Fetch answers and their pictures, as long as they live."""

from typing import Any

from fastapi import APIRouter, Depends, Request
from starlette.responses import JSONResponse, Response

from panoloc.service.answer import picture_path
from panoloc.service.http.access import require
from panoloc.service.http.responses import file_response
from panoloc.service.http.schemas import Localization, PendingLocalization
from panoloc.service.http.schemas.localization_examples import LOCALIZATION_EXAMPLE, PENDING_EXAMPLE
from panoloc.service.problems import error_responses
from panoloc.service.services import services_of

router = APIRouter(tags=["localization"], dependencies=[Depends(require("localize"))])

_ERRORS = (401, 403, 404, 503)
_EITHER: dict[str, Any] = {
    "description": "The answer; or, while `status` is `queued`, `running` or `failed`, the state of the query.",
    "model": Localization | PendingLocalization,
    "content": {
        "application/json": {
            "examples": {
                "done": {"value": LOCALIZATION_EXAMPLE},
                "running": {"value": PENDING_EXAMPLE},
            }
        }
    },
}


@router.get(
    "/localizations/{localization_id}",
    summary="Fetch an answer",
    responses={200: _EITHER, **error_responses(*_ERRORS)},
)
async def get_localization(request: Request, localization_id: str) -> Response:
    """Return the answer to a query, or its state."""
    found = await services_of(request).localizations.get(localization_id)
    waiting = found["status"] in ("queued", "running")
    return JSONResponse(found, headers={"Retry-After": "1"} if waiting else None)


def _offer_picture(name: str, summary: str, description: str) -> None:
    """Add the path of one picture; `name`: as queries ask for it, see `panoloc.service.jobs.ARTIFACTS`."""

    async def get_picture(request: Request, localization_id: str) -> Response:
        data = await services_of(request).localizations.picture(localization_id, name)
        return Response(data, media_type="image/png", headers={"Cache-Control": "private, max-age=3600, immutable"})

    router.add_api_route(
        picture_path("{localization_id}", name),
        get_picture,
        name=f"get_{name}",
        summary=summary,
        description=description,
        response_class=Response,
        responses=file_response("The picture.", ("image/png",), *_ERRORS),
    )


_offer_picture(
    "score_map_2d", "The panorama tinted by its score map", "Return a picture of how well the panorama fits the scan."
)
_offer_picture(
    "score_map_3d",
    "The scan at the estimated pose, tinted by its score map",
    "Return a picture of how well the scan fits the panorama.",
)
_offer_picture(
    "overlay",
    "The panorama above the scan at the estimated pose",
    "Return a picture for checking the pose by eye.",
)
