"""Place a photo of a batch by hand, and undo it."""

from typing import Annotated, Any

import numpy as np
from fastapi import Depends, Path, Request
from starlette.responses import JSONResponse, Response

from panoloc.core.geometry.pose import Pose
from panoloc.service.answer import Localization
from panoloc.service.batches.by_hand import ByHand, HandPlacing, Pairs, Placed, Placement
from panoloc.service.batches.record import BatchRecord
from panoloc.service.errors import InvalidOptionsError
from panoloc.service.http.access import note_change, own_batch, require
from panoloc.service.http.openapi import api_router, json_body, json_response
from panoloc.service.http.routes.batches import item_document
from panoloc.service.http.routes.localize import QUERY_ERRORS, while_connected
from panoloc.service.http.schemas.batches import BatchItem, HandPlacement, HandPose
from panoloc.service.http.schemas.examples import HAND_PLACEMENT_EXAMPLE, HAND_POSE_EXAMPLE
from panoloc.service.http.uploads import read_body
from panoloc.service.http.validation import named_field, parse_json
from panoloc.service.services import Services, services_of

router = api_router("batches", Depends(require("localize")))
_Number = Annotated[int, Path(ge=0, description="`number` of its item.")]
_PATH = "/batches/{batch_id}/images/{number}/pose"


@router.post(
    _PATH,
    summary="Place a photo by hand: by a rough pose, or by points clicked in photo and scan",
    responses=json_response(HandPlacement, HAND_PLACEMENT_EXAMPLE, *QUERY_ERRORS),
    openapi_extra=json_body(HandPose, HAND_POSE_EXAMPLE),
)
async def place_by_hand(request: Request, batch_id: str, number: _Number) -> Response:
    """Solve the pairs, refine the pose on photo and scan, and with `confirm` store the better of both, or the one it names.

    A confirmed photo is `localized`, `placed_by` `hand`, in lists, tours and exports; `DELETE` brings the answer of the search back. The
    same request can be sent again.
    """
    services, record = services_of(request), own_batch(request, batch_id, number)
    wanted = parse_json(HandPose, await read_body(request.stream()), "body")
    if not await services.batches.results(batch_id, [number]):
        raise InvalidOptionsError.of(
            "number",
            f"expected a photo that has been searched for, but {record.names[number]} still waits; try again once it is done",
        )
    placing = _placing(services)
    with named_field():
        placement = await while_connected(
            request, placing.place(record, number, _by_hand(wanted, record), request.state.request_id)
        )
    if wanted.confirm:
        which = placement.better if wanted.confirm is True else wanted.confirm
        if placement.refined is None and (which == "refined" or (wanted.refine and wanted.confirm is True)):
            raise InvalidOptionsError.of(
                "refine",
                "expected a pose from which the scan can be compared with the photo, got none; set it elsewhere, or confirm the given one "
                '(confirm: "given")',
            )
        await placing.confirm(record, number, placement.answers[which])
        note_change(request, "photo placed", f"{batch_id} {number}")
    return JSONResponse(_document(placement, await _item(services, record, number)))


@router.delete(
    _PATH,
    summary="Undo a placement by hand",
    responses=json_response(BatchItem, HAND_PLACEMENT_EXAMPLE["item"], 401, 403, 404, 503),
)
async def undo_placement(request: Request, batch_id: str, number: _Number) -> Response:
    """Return to the answer of the search, and return the photo as it is then."""
    services, record = services_of(request), own_batch(request, batch_id, number)
    await _placing(services).undo(record, number)
    note_change(request, "photo placed", f"{batch_id} {number}")
    return JSONResponse(await _item(services, record, number))


def _placing(services: Services) -> HandPlacing:
    return HandPlacing(services.batches, services.localizations, services.settings.max_pixels)


def _by_hand(wanted: HandPose, record: BatchRecord) -> ByHand:
    """Return what is wanted. Raises InvalidOptionsError where it does not say in which map."""
    map_id = wanted.map_id or (record.map_ids[0] if len(record.map_ids) == 1 else None)
    if map_id is None:
        raise InvalidOptionsError.of(
            "map_id", "expected the map of the pose, for the batch has searched several; name one"
        )
    pose = pairs = None
    if wanted.pose is not None:
        place, turned = wanted.pose.map_from_camera.position_m, wanted.pose.map_from_camera.quaternion
        pose = Pose.from_frame((place.x, place.y, place.z), (turned.x, turned.y, turned.z, turned.w), wanted.pose.frame)
    if wanted.pairs is not None:
        pixels, points = [each.pixel for each in wanted.pairs], [each.position_m for each in wanted.pairs]
        pairs = Pairs(np.array(pixels, np.float64), np.array(points, np.float64))
    return ByHand(map_id, pose, pairs, wanted.position_std_m, wanted.orientation_std_deg, wanted.refine)


async def _item(services: Services, record: BatchRecord, number: int) -> dict[str, Any]:
    return item_document(record, number, (await services.batches.results(record.id, [number])).get(number))


def _document(placement: Placement, item: dict[str, Any]) -> dict[str, Any]:
    return {
        "given": _placed(placement.given, placement.answers["given"]),
        "refined": None if placement.refined is None else _placed(placement.refined, placement.answers["refined"]),
        "better": placement.better,
        "moved_m": placement.moved_m,
        "moved_deg": placement.moved_deg,
        "item": item,
    }


def _placed(placed: Placed, answer: Localization) -> dict[str, Any]:
    off, evidence = placed.residuals_px, placed.evidence
    return {
        "pose": placed.pose.model_dump(mode="json"),
        "camera": answer.images[0].camera.model_dump(mode="json"),
        "residuals_px": off,
        "rms_px": None if off is None else round(float(np.sqrt(np.square(off).mean())), 2),
        "agreement": evidence.agreement,
        "confidence": evidence.confidence,
        "accuracy": None if evidence.accuracy is None else evidence.accuracy.model_dump(mode="json"),
        "warnings": list(evidence.warnings),
    }
