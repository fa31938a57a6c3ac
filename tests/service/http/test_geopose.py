"""Protocols of others over HTTP: GeoPose, the GeoPoseProtocol of OSCP, OpenFLAME."""

import base64
import json
from typing import Any, get_args

import httpx
import numpy as np
import pytest

from panoloc.core.options import Frame, Status
from panoloc.service.http.schemas.geopose import CameraReading
from tests.core.exports.tours import GOLDEN
from tests.service.http import geopose_schemas
from tests.service.http.fake_pool import outcome_of
from tests.service.http.running_service import RunningService, png_of

pytestmark = pytest.mark.anyio

PNG = png_of(8, 4)
PLACE = {"latitude_deg": 47.7, "longitude_deg": -122.3, "height_m": 11.5}
GEOPOSE = [47.699977515, -122.299983346, 13.100000612]


def sees_golden(running: RunningService, status: Status = "localized") -> None:
    """Let workers find the golden pose."""
    running.pool.outcome_of = lambda job: outcome_of(job, GOLDEN, status)


def question(image: bytes = PNG, place: tuple[float, float] | None = None, **reading: Any) -> dict[str, Any]:
    """Return a request of the GeoPoseProtocol with little more than its image."""
    readings: dict[str, Any] = {"cameraReadings": [{"imageBytes": base64.b64encode(image).decode(), **reading}]}
    if place is not None:
        readings["geolocationReadings"] = [{"latitude": place[0], "longitude": place[1], "accuracy": 30}]
    return {"id": "question 7", "timestamp": 1, "type": "geopose", "sensors": [], "sensorReadings": readings}


async def ask(running: RunningService, body: Any, **query: Any) -> httpx.Response:
    accept = {"Accept": "application/vnd.oscp+json;version=2.0;"}
    return await running.client.post("/geopose", json=body, params=query, headers=accept)


async def placed_map(running: RunningService, place: dict[str, Any] = PLACE) -> str:
    return await running.ready_map(json.dumps({"georeference": place}))


async def test_an_image_is_answered_with_where_it_was_taken_on_earth(running: RunningService) -> None:
    sees_golden(running)
    map_id = await placed_map(running)
    reply = await ask(running, question(imageFormat="RGBA32", size=[8, 4], sensorId="x", privacy={"dataRetention": []}))
    assert reply.status_code == 200, reply.text
    assert reply.headers["content-type"].replace(" ", "") == "application/vnd.oscp+json;version=2.0"
    body = reply.json()
    geopose_schemas.check(body, geopose_schemas.RESPONSE)
    assert (body["id"], body["type"]) == ("question 7", "geopose")
    assert body["accuracy"] == {"position": 0.02, "orientation": 0.3}
    assert list(body["geopose"]["position"].values()) == pytest.approx(GEOPOSE, abs=2e-9)
    (job,) = running.pool.jobs
    assert (job.images[0].data, job.images[0].camera, [ref.id for ref in job.maps]) == (PNG, None, [map_id])


async def test_answers_have_the_geopose_whatever_their_frame_is(running: RunningService) -> None:
    sees_golden(running)
    map_id = await placed_map(running)
    for frame in get_args(Frame):
        data = {"map_id": map_id, "options": json.dumps({"frame": frame})}
        found = (await running.client.post("/localize", files={"image": PNG}, data=data)).json()["geopose"]
        geopose_schemas.check(found, geopose_schemas.STRICT_GEOPOSE)
        assert list(found["position"].values()) == pytest.approx(GEOPOSE, abs=2e-9)
        assert found["quaternion"]["w"] == pytest.approx(0.892942567, abs=1e-9)
    await running.client.patch(f"/maps/{map_id}", json={"georeference": None})
    assert (await running.client.post("/localize", files={"image": PNG}, data=data)).json()["geopose"] is None


async def test_maps_are_those_around_the_geolocation_or_those_that_are_named(running: RunningService) -> None:
    near = await placed_map(running)
    far = await placed_map(running, {"latitude_deg": 48.7, "longitude_deg": -122.3})
    await running.ready_map()  # nowhere on Earth
    for place, query, expected in (
        (None, {}, {near, far}),
        ((47.7005, -122.299), {}, {near}),
        ((47.7005, -122.299), {"map_id": far}, {far}),
    ):
        reply = await ask(running, question(place=place), **query)
        assert reply.status_code == 200, reply.text
        assert {ref.id for ref in running.pool.jobs[-1].maps} == expected
    reply = await ask(running, question(place=(10.0, 10.0)))
    assert (reply.status_code, reply.json()["type"]) == (404, "/problems/map-not-found")


async def test_a_request_of_the_published_client_is_understood(running: RunningService) -> None:
    near = await placed_map(running)
    await placed_map(running, {"latitude_deg": 48.7, "longitude_deg": -122.3})
    privacy: dict[str, list[str]] = {"dataRetention": [], "dataAcceptableUse": []}
    of_sensor: dict[str, Any] = {"timestamp": 1750939398316, "sensorId": "camera", "privacy": privacy}
    # As `GeoPoseRequest` of @oarc/gpp-access 0.2.1 writes itself, with a camera that nobody described; lines as mail has them.
    body = question(
        imageFormat="JPG",
        size=[8, 4],
        sequenceNumber=0,
        imageOrientation={"mirrored": False, "rotation": 0},
        params={"model": "UNKNOWN", "modelParams": []},
        **of_sensor,
    )
    reading = body["sensorReadings"]["cameraReadings"][0]
    reading["imageBytes"] = base64.encodebytes(PNG).decode()
    unknown = dict.fromkeys(("altitude", "accuracy", "altitudeAccuracy", "heading", "speed"), 0)
    place = {"latitude": 47.7, "longitude": -122.3, **unknown, **of_sensor}
    body["sensorReadings"]["geoLocationReadings"] = [place]
    body["sensors"] = [{"id": "camera", "type": "camera"}, {"id": "gps", "type": "geolocation"}]
    reply = await ask(running, body)
    assert reply.status_code == 200, reply.text
    (job,) = running.pool.jobs
    assert (job.images[0].data, job.images[0].camera, [ref.id for ref in job.maps]) == (PNG, None, [near])


@pytest.mark.parametrize(
    ("status", "why"), [("ambiguous", "looks the same from several places"), ("not_localized", "fits no place")]
)
async def test_only_a_localized_image_has_a_place(running: RunningService, status: Status, why: str) -> None:
    sees_golden(running, status)
    map_id = await placed_map(running)
    reply = await ask(running, question())
    assert (reply.status_code, reply.json()["type"]) == (404, "/problems/no-pose")
    assert why in reply.json()["detail"]
    assert reply.headers["content-type"] == "application/problem+json"
    reply = await running.client.post(f"/{map_id}/localize/image", files={"image": PNG})
    assert reply.json() == {"success": False, "pose": None, "confidence": 0}
    geopose_schemas.check(reply.json(), geopose_schemas.OPENFLAME_ANSWER)


async def test_a_map_without_a_georeference_is_404_with_what_to_set(running: RunningService) -> None:
    map_id = await running.ready_map()
    reply = await ask(running, question(), map_id=map_id)
    assert (reply.status_code, "georeference" in reply.json()["detail"]) == (404, True)


NO_REQUESTS: list[tuple[Any, int, str]] = [
    (b"no json", 400, "JSON"),
    ({}, 422, "sensorReadings"),
    ({"sensorReadings": {"cameraReadings": []}}, 422, "cameraReadings"),
    ({"sensorReadings": {"cameraReadings": [{"imageBytes": "AAAA"}] * 2}}, 422, "one image"),
    ({"sensorReadings": {"cameraReadings": [{"imageBytes": "%%%"}]}}, 422, "base64"),
    ({"sensorReadings": {"cameraReadings": [{"imageBytes": "AAAA"}]}}, 415, "JPEG"),
    (question(imageOrientation={"mirrored": True, "rotation": 0}), 422, "mirrored"),
    (question(imageOrientation={"rotation": 90}), 422, "rotate it first"),
    (question(params={"model": "PINHOLE", "modelParams": [1, 2, 3]}), 422, "PINHOLE"),
    (question(params={"model": "PINHOLE", "modelParams": [1, 2, 3, 4]}), 422, "size"),
    (question(params={"model": "THIN_PRISM", "modelParams": [1] * 12}, size=[8, 4]), 422, "THIN_PRISM"),
    (question(place=(95.0, 0.0)), 422, "latitude"),
    (question(image=png_of(8, 4) + b"x" * 3000), 413, "PANOLOC_MAX_IMAGE_BYTES"),
]


@pytest.mark.settings(max_image_bytes=2000)
async def test_an_invalid_request_is_refused(running: RunningService, redis_client: object) -> None:
    await placed_map(running)
    for body, status, words in NO_REQUESTS:
        content = body if isinstance(body, bytes) else json.dumps(body).encode()
        reply = await running.client.post("/geopose", content=content)
        assert (reply.status_code, words in reply.json()["detail"]) == (status, True), reply.text
        assert reply.headers["content-type"] == "application/problem+json"
    assert running.pool.jobs == []


@pytest.mark.parametrize(
    ("model", "numbers", "expected"),
    [
        ("SIMPLE_PINHOLE", [500, 320, 240], ("pinhole", 500, 500, 320, [])),
        ("PINHOLE", [500, 510, 320, 240], ("pinhole", 500, 510, 320, [])),
        ("SIMPLE_RADIAL", [500, 320, 240, 0.1], ("opencv", 500, 500, 320, [0.1, 0, 0, 0])),
        ("RADIAL", [500, 320, 240, 0.1, -0.01], ("opencv", 500, 500, 320, [0.1, -0.01, 0, 0])),
        ("OPENCV", [500, 510, 320, 240, 0.1, 0.2, 0.01, 0.02], ("opencv", 500, 510, 320, [0.1, 0.2, 0.01, 0.02])),
        ("OPENCV_FISHEYE", [300, 310, 320, 240, 0.1, 0, 0, 0], ("opencv_fisheye", 300, 310, 320, [0.1, 0, 0, 0])),
    ],
)
def test_cameras_of_the_protocol_become_cameras_of_opencv(
    model: str, numbers: list[float], expected: tuple[str, float, float, float, list[float]]
) -> None:
    reading = {"imageBytes": "", "size": [640, 480], "params": {"model": model, "modelParams": numbers}}
    camera = CameraReading.model_validate(reading).camera()
    assert camera is not None
    assert (camera.model, camera.fx_px, camera.fy_px, camera.cx_px, camera.distortion) == expected


async def test_openflame_gets_the_pose_in_its_own_axes(running: RunningService) -> None:
    sees_golden(running)
    map_id = await running.ready_map('{"name": "3rd floor"}')
    reply = await running.client.post(
        f"/{map_id}/localize/image", files={"image": PNG}, data={"aframe_camera_matrix_world": "1,0,0"}
    )
    assert reply.status_code == 200, reply.text
    geopose_schemas.check(reply.json(), geopose_schemas.OPENFLAME_ANSWER)
    expected: list[list[float]] = [
        [-0.620609899, 0.117343287, -0.775289563, -2.5],
        [-0.080922756, 0.973874809, 0.212177672, 1.6],
        [0.779932600, 0.194418132, -0.594900605, 1.25],
        [0, 0, 0, 1],
    ]
    assert np.allclose(reply.json()["pose"], expected, atol=1e-8)
    assert running.pool.jobs[-1].options.frame == "webxr"
    for path in (f"/{map_id}/capabilities", f"/{map_id}/capabilities/"):
        reply = await running.client.get(path)
        assert reply.status_code == 200, reply.text
        geopose_schemas.check(reply.json(), geopose_schemas.OPENFLAME_CAPABILITIES)
        assert reply.json()["commonName"] == "3rd floor"
        assert reply.json()["services"][0]["url"].endswith(f"/{map_id}/localize/image")


async def test_paths_below_a_map_shadow_no_other(running: RunningService) -> None:
    for method, path, kind in (
        ("GET", "/maps/capabilities", "map-not-found"),
        ("GET", "/map_none/capabilities", "map-not-found"),
        ("GET", "/batches/capabilities", "batch-not-found"),
        ("GET", "/office/capabilities", "no-such-path"),
        ("POST", "/maps/localize/image", "no-such-path"),
        ("POST", "/map_none/localize/image", "malformed-request"),
        ("GET", "/map_none/localize/image", "method-not-allowed"),
    ):
        reply = await running.client.request(method, path)
        assert reply.json()["type"] == f"/problems/{kind}", path
    reply = await running.client.post("/map_none/localize/image", files={"image": PNG})
    assert reply.status_code == 404
    assert (await running.client.post("/map_none/localize/image", files={"mask": PNG})).status_code == 422
