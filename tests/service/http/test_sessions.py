"""Several images in one query: what belongs together reaches the worker, what does not is refused by name."""

import json
import math
from typing import Any

import httpx
import pytest

from panoloc.core.options import MAX_IMAGES, SessionOptions, TrackedPose
from panoloc.service.answer import Localization
from panoloc.service.errors import InvalidOptionsError
from panoloc.service.http.query_images import query_images
from panoloc.service.http.schemas.queries import LocalizeOptions
from panoloc.service.http.validation import parse_json
from panoloc.service.jobs import QueryImage
from tests.service.http.running_service import RunningService, png_of

pytestmark = pytest.mark.anyio

LENS = {"model": "pinhole", "hfov_deg": 69}
TURNED = {"x": 0.0, "y": 0.0, "z": 0.5, "w": math.sqrt(0.75)}


def entry(x: float = 0.0, **changes: Any) -> dict[str, Any]:
    """Return an entry of `cameras` with a pose; changes: of the pose, or of the rest."""
    pose = {"position_m": {"x": x, "y": 0.2, "z": 1.5}, "quaternion": TURNED}
    pose |= {name: changes.pop(name) for name in ("position_m", "quaternion") if name in changes}
    return {**LENS, "session_from_camera": pose, **changes}


async def ask(
    running: RunningService, num_images: int, options: dict[str, Any] | str, num_masks: int = 0, sides: int = 8
) -> httpx.Response:
    """Send so many images, each of another width, and masks."""
    files: list[tuple[str, Any]] = [("map_id", (None, await running.ready_map()))]
    files += [("image", (f"{number}.png", png_of(sides + number, sides))) for number in range(num_images)]
    files += [("mask", (f"{number}.png", png_of(sides + number, sides))) for number in range(num_masks)]
    files.append(("options", (None, options if isinstance(options, str) else json.dumps(options))))
    return await running.client.post("/localize", files=files)


async def test_every_image_reaches_the_worker_with_its_mask_its_camera_and_its_pose(running: RunningService) -> None:
    cameras = [entry(0.1 * number, hfov_deg=60 + number) for number in range(3)]
    options = {"frame": "webxr", "cameras": cameras, "session": {"up": "known", "position_noise_m": 0.02}}
    reply = await ask(running, 3, options, num_masks=3)
    assert reply.status_code == 200, reply.text
    Localization.model_validate(reply.json())
    (job,) = running.pool.jobs
    assert [image.data for image in job.images] == [png_of(8 + number, 8) for number in range(3)]
    assert [image.mask for image in job.images] == [image.data for image in job.images]
    assert [image.camera.hfov_deg for image in job.images if image.camera] == [60, 61, 62]
    assert job.images[2].session_from_camera == TrackedPose((0.2, 0.2, 1.5), (0.0, 0.0, 0.5, math.sqrt(0.75)))
    assert job.options.session == SessionOptions(up_known=True, position_noise_m=0.02)
    assert job.options.frame == "webxr"


def images_of(num_images: int, options: dict[str, Any], num_masks: int = 0) -> tuple[QueryImage, ...]:
    """Return what becomes of so many images, by their number, and masks."""
    images, masks = ([b"%d" % number for number in range(count)] for count in (num_images, num_masks))
    return query_images(images, masks, parse_json(LocalizeOptions, json.dumps(options).encode(), "options"))


def test_one_mask_is_for_all_images() -> None:
    assert [image.mask for image in images_of(2, {"cameras": [entry(), entry()]}, num_masks=1)] == [b"0", b"0"]


def test_one_image_may_have_a_pose() -> None:
    (image,) = images_of(1, {"cameras": [entry(3.0)], "session": {"up": "known"}})
    assert image.session_from_camera is not None
    assert image.session_from_camera.position_m == (3.0, 0.2, 1.5)


def test_a_session_may_contain_panoramas_and_images_whose_camera_is_in_their_metadata() -> None:
    sphere = {name: value for name, value in entry(model="equirectangular").items() if name != "hfov_deg"}
    bare = {"session_from_camera": entry(1.0)["session_from_camera"]}
    first, second, third = images_of(3, {"cameras": [sphere, bare, entry(0.5)]})
    assert first.camera is not None
    assert first.camera.model == "equirectangular"
    assert second.camera is None
    assert second.session_from_camera is not None
    assert third.camera is not None


def test_a_query_without_options_is_one_image_and_no_session() -> None:
    assert images_of(1, {}) == (QueryImage(b"0"),)


def test_a_quaternion_that_is_a_little_off_is_made_unit() -> None:
    (image,) = images_of(1, {"cameras": [entry(quaternion={"x": 0.0, "y": 0.0, "z": 0.5, "w": 0.87})]})
    assert image.session_from_camera is not None
    assert math.hypot(*image.session_from_camera.quaternion_xyzw) == pytest.approx(1, abs=1e-12)


@pytest.mark.parametrize(
    ("num_images", "options", "field", "says"),
    [
        (2, {}, "cameras", "session_from_camera for each of the 2 images, got 0"),
        (2, {"cameras": [LENS]}, "cameras", "session_from_camera for each of the 2 images, got 0"),
        (2, {"cameras": [entry()]}, "cameras.0.session_from_camera", "one entry of `cameras` per image"),
        (3, {"cameras": [entry(), entry()]}, "cameras", "one per image (3), got 2"),
        (1, {"cameras": [entry(), entry()]}, "cameras", "one entry, got 2"),
        (2, {"cameras": [entry(), LENS]}, "cameras.1.session_from_camera", "got 1 of them"),
        (2, {"cameras": [entry(), entry(150.0)]}, "cameras.1.session_from_camera.position_m", "at most 100 m"),
        (1, {"cameras": [LENS], "session": {"up": "known"}}, "session.up", "hints.upright"),
        (1, {"cameras": [LENS] * 33}, "cameras", "32 items or fewer"),
        (1, {"cameras": [entry(quaternion=TURNED | {"w": 2})]}, "cameras.0.session_from_camera.quaternion", "norm 2"),
        (1, {"cameras": [entry(quaternion=dict.fromkeys("xyzw", 0))]}, "cameras.0.session_from_camera.quaternion", "{x, y, z, w}"),
        (1, {"cameras": [entry(math.nan)]}, "cameras.0.session_from_camera.position_m.x", "finite"),
        (1, {"cameras": [entry(1e30)]}, "cameras.0.session_from_camera.position_m.x", "at most"),
        (1, {"cameras": [entry(position_m={"x": 0, "y": 0})]}, "cameras.0.session_from_camera.position_m.z", "expected a value"),
        (1, {"cameras": [entry(quaternion=TURNED | {"x": math.inf})]}, "cameras.0.session_from_camera.quaternion.x", "finite"),
        (1, {"cameras": [entry()], "session": {"position_noise_m": -0.1}}, "session.position_noise_m", "at least"),
        (1, {"cameras": [entry()], "session": {"orientation_noise_deg": 31}}, "session.orientation_noise_deg", "at most"),
        (1, {"cameras": [entry()], "session": {"up": "maybe"}}, "session.up", "'known'"),
        (1, {"cameras": [{}]}, "cameras.0", "model: expected one of equirectangular"),
        (1, {"cameras": [{"width_px": 64, "height_px": 48}]}, "cameras.0", "model: expected one of equirectangular"),
        (1, {"cameras": [{**entry(hfov_deg=0), "model": None}]}, "cameras.0", "model: expected one of equirectangular"),
        (1, {"cameras": []}, "cameras", "1 or more items"),
        # What a camera may be, tests/core/camera says.
        (1, {"cameras": [{"model": "pinhole", "hfov_deg": 400}]}, "cameras.0", "hfov_deg: expected 1 to 170 degrees"),
        (1, {"cameras": [{**LENS, "fov": 3}]}, "cameras.0.fov", "no field of this name"),
    ],
)  # fmt: skip
def test_cameras_and_images_that_do_not_belong_together_are_refused_by_field(
    num_images: int, options: dict[str, Any], field: str, says: str
) -> None:
    with pytest.raises(InvalidOptionsError) as caught:
        images_of(num_images, options)
    assert field in [each["field"] for each in caught.value.fields]
    assert says in str(caught.value)


def test_masks_are_one_or_as_many_as_the_images() -> None:
    with pytest.raises(InvalidOptionsError, match=r"^mask: .*one for all, or one per image \(3\), got 2"):
        images_of(3, {"cameras": [entry()] * 3}, num_masks=2)


async def test_a_refusal_names_its_field_and_the_next_query_is_answered(running: RunningService) -> None:
    reply = await ask(running, 2, {"cameras": [entry(), LENS]})
    problem = reply.json()
    assert (reply.status_code, problem["type"]) == (422, "/problems/invalid-options"), problem
    assert [each["field"] for each in problem["fields"]] == ["cameras.1.session_from_camera"]
    assert running.pool.jobs == []
    assert (await ask(running, 1, {})).status_code == 200


async def test_the_most_images_are_taken_and_one_more_is_refused(running: RunningService) -> None:
    assert (await ask(running, MAX_IMAGES, {"cameras": [entry()] * MAX_IMAGES})).status_code == 200
    reply = await ask(running, MAX_IMAGES + 1, {"cameras": [entry()] * MAX_IMAGES})
    problem = reply.json()
    assert (reply.status_code, problem["fields"][0]["field"]) == (422, "image")
    assert "at most 32 parts" in problem["detail"]
    assert len(running.pool.jobs) == 1


async def test_the_limit_of_pixels_counts_all_images_together(running: RunningService) -> None:
    reply = await ask(running, 4, {"cameras": [entry()] * 4}, sides=6000)
    problem = reply.json()
    assert (reply.status_code, problem["type"]) == (413, "/problems/too-many-pixels")
    assert "4 files together" in problem["detail"]
    assert "PANOLOC_MAX_PIXELS" in problem["detail"]
    assert running.pool.jobs == []


async def test_a_file_that_is_no_image_is_named_by_its_number(running: RunningService) -> None:
    files: list[tuple[str, Any]] = [("map_id", (None, await running.ready_map()))]
    files += [("image", ("a.png", data)) for data in (png_of(8, 8), b"some text", png_of(8, 8))]
    files.append(("options", (None, json.dumps({"cameras": [entry()] * 3}))))
    reply = await running.client.post("/localize", files=files)
    assert (reply.status_code, reply.json()["type"]) == (415, "/problems/unknown-image-format")
    assert "(image 2 of 3)" in reply.json()["detail"]


async def test_all_images_of_a_session_are_kept_when_the_setting_says_so(running: RunningService) -> None:
    localizations = running.app.state.services.localizations
    localizations.settings = localizations.settings.model_copy(update={"keep_images": True})
    body = (await ask(running, 2, {"cameras": [entry(), entry()]})).json()
    assert sorted(running.storage.names("panoramas")) == [f"{body['id']}-01.png", f"{body['id']}-02.png"]
