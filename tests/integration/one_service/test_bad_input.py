"""Bad input of every way through a running service: what each is told, and that the next good request is answered."""

from collections.abc import Callable

import httpx
import numpy as np
import pytest

from tests.core.image.picture_files import encoded, png_bomb
from tests.core.painted_box import PaintedBox
from tests.core.scan.mesh_files import obj_files, zip_of
from tests.integration.running_service import RunningService, eventually
from tests.integration.small_room import small_room

pytestmark = pytest.mark.integration


def jpeg(width: int, height: int) -> bytes:
    return encoded(np.random.default_rng(0).integers(0, 255, (height, width, 3), dtype=np.uint8), "JPEG")


# Files that cannot become maps: name, content, status, and what is in the message. One that fails after the upload counts as 422.
# What the readers refuse beside these is tested with them; from here on all of it takes the same way.
BAD_SCANS: dict[str, tuple[str, Callable[[], bytes], int, tuple[str, ...]]] = {
    "truncated PLY": (
        "room.ply",
        lambda: small_room().scan[: len(small_room().scan) // 2],
        422,
        ("expected", "points"),
    ),
    "wrong extension": ("room.ply", lambda: jpeg(64, 32), 415, ("expected",)),
    "half an OBJ": (
        "room.zip",
        lambda: zip_of({name: data for name, data in obj_files(PaintedBox()).items() if "wall 3" not in name}),
        422,
        ("wall 3.png", "no such file"),
    ),
}
BAD_IMAGES = {
    "text as image": (b"this is no image at all, but a letter " * 40, 415),
    "truncated JPEG": (jpeg(1024, 512)[:20_000], 422),
    "PNG bomb": (png_bomb(40_000, 20_000), 413),
    "3:2 photo": (jpeg(600, 400), 422),
}


def localize(service: RunningService, image: bytes, map_id: str) -> httpx.Response:
    return service.http.post("/localize", files={"image": ("photo.jpg", image)}, data={"map_id": map_id})


def assert_still_answers(service: RunningService, map_id: str) -> None:
    answer = localize(service, small_room().panorama, map_id)
    assert answer.status_code == 200
    assert small_room().error_of(answer.json()).within(0.05, 5.0)


def test_bad_scans_are_refused_with_a_reason_while_queries_are_answered(service: RunningService, map_id: str) -> None:
    posted = {
        kind: service.http.post("/maps", files={"file": (name, make())}) for kind, (name, make, *_) in BAD_SCANS.items()
    }
    assert_still_answers(service, map_id)
    for kind, answer in posted.items():
        *_, expected, says = BAD_SCANS[kind]
        status, said = answer.status_code, answer.json()
        if status == 202:
            path = f"/maps/{said['id']}"
            assert eventually(lambda path=path: service.http.get(path).json()["status"] in ("ready", "failed"), 240)  # type: ignore[misc]
            status, said = 422, service.http.get(path).json()["error"]
        assert status == expected, kind
        assert all(word in said["detail"].lower() for word in says), said
    assert_still_answers(service, map_id)


def test_bad_images_are_refused_with_a_reason_and_the_next_query_is_answered(
    service: RunningService, map_id: str
) -> None:
    for kind, (image, status) in BAD_IMAGES.items():
        answer = localize(service, image, map_id)
        assert answer.status_code == status, kind
        assert answer.headers["content-type"].startswith("application/problem+json")
        assert {"type", "title", "status", "detail", "request_id"} <= set(answer.json())
    assert_still_answers(service, map_id)
