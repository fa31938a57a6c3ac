"""Photos as phones have them, through a running service: HEIC and AVIF get the answer of the same picture as a JPEG."""

import io
import json

import numpy as np
import pytest
from PIL import Image

from panoloc.core.geometry.pose import Pose, pose_error
from panoloc.lab.rooms import sample_pose, take_panorama
from tests.core.image.picture_files import encoded, heic, phone_exif
from tests.integration.running_service import RunningService
from tests.integration.small_room import room_scene

pytestmark = pytest.mark.integration


def found(service: RunningService, map_id: str, image: bytes) -> Pose:
    reply = service.localize(image, map_id, json.dumps({"artifacts": ["overlay"]}))
    assert reply.status_code == 200, reply.text
    assert reply.json()["status"] == "localized", reply.text
    matrix = np.array(reply.json()["pose"]["map_from_camera"]["matrix"])
    picture = service.http.get(reply.json()["artifacts"]["overlay"]).content
    assert Image.open(io.BytesIO(picture)).format == "PNG"
    return Pose(matrix[:3, :3], matrix[:3, 3])


def test_a_heic_and_an_avif_get_the_pose_of_their_jpeg(service: RunningService, map_id: str) -> None:
    taken_at = sample_pose(room_scene(), np.random.default_rng(1))
    pixels = take_panorama(room_scene(), taken_at, 512).color
    expected = found(service, map_id, encoded(pixels, "JPEG", quality=92))
    assert pose_error(expected, taken_at).within(0.05, 3)
    for image in (heic(pixels, phone_exif()), encoded(pixels, "AVIF", quality=90)):
        assert pose_error(found(service, map_id, image), expected).within(0.01, 0.3)


def test_a_hostile_heic_is_refused_and_the_next_query_is_answered(service: RunningService, map_id: str) -> None:
    pixels = take_panorama(room_scene(), sample_pose(room_scene(), np.random.default_rng(1)), 512).color
    whole = heic(pixels, phone_exif())
    at = whole.index(b"Exif\0")
    crashing = whole[:at] + b"\xecxif" + whole[at + 4 :]
    for image, status, said in (
        (whole[: len(whole) // 2], 422, "ends early or is damaged"),
        (crashing, 422, "or as JPEG"),
        (b"\0\0\0\x18ftypisom\0\0\2\0isomiso2", 415, "HEIC or AVIF"),
        (b"", 415, "an empty file"),
    ):
        reply = service.localize(image, map_id)
        assert (reply.status_code, said in reply.json()["detail"]) == (status, True), reply.text
    found(service, map_id, whole)
