"""Several images in one query: what belongs together reaches the worker, what does not is refused by name."""

import json
import math
from typing import Any

import httpx
import pytest

from core.options import MAX_IMAGES, SessionOptions, TrackedPose
from service.http.schemas import Localization
from service.http.schemas.localization_examples import SESSION_EXAMPLE
from service.jobs import QueryImage
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


async def test_one_mask_is_for_all_images(running: RunningService) -> None:
    await ask(running, 2, {"cameras": [entry(), entry()]}, num_masks=1)
    assert [image.mask for image in running.pool.jobs[0].images] == [png_of(8, 8)] * 2


async def test_one_image_may_have_a_pose(running: RunningService) -> None:
    assert (await ask(running, 1, {"cameras": [entry(3.0)], "session": {"up": "known"}})).status_code == 200
    (image,) = running.pool.jobs[0].images
    assert image.session_from_camera is not None
    assert image.session_from_camera.position_m == (3.0, 0.2, 1.5)


async def test_full_panoramas_are_images_of_a_session_like_others(running: RunningService) -> None:
    sphere = {name: value for name, value in entry(model="equirectangular").items() if name != "hfov_deg"}
    assert (await ask(running, 2, {"cameras": [sphere, entry(0.5)]})).status_code == 200


async def test_an_entry_with_a_pose_alone_leaves_the_camera_to_the_image(running: RunningService) -> None:
    bare = {"session_from_camera": entry(1.0)["session_from_camera"]}
    assert (await ask(running, 2, {"cameras": [bare, entry()]})).status_code == 200
    first, second = running.pool.jobs[0].images
    assert first.camera is None
    assert second.camera is not None
    assert first.session_from_camera is not None


@pytest.mark.parametrize(
    "incomplete",
    [
        {},
        {"hfov_deg": 69},
        {"width_px": 64, "height_px": 48},
        {**entry(hfov_deg=0), "model": None},
        {"session_from_camera": None},
    ],
    ids=["nothing", "a field of view", "a size", "a pose and a field of view", "no pose"],
)
async def test_a_camera_without_a_model_is_refused(running: RunningService, incomplete: dict[str, Any]) -> None:
    reply = await ask(running, 1, {"cameras": [incomplete]})
    assert (reply.status_code, reply.json()["fields"][0]["field"]) == (422, "cameras.0")
    assert "model: expected one of equirectangular" in reply.json()["detail"]


async def test_a_query_without_options_is_one_image_and_no_session(running: RunningService) -> None:
    await ask(running, 1, {})
    assert running.pool.jobs[0].images == (QueryImage(png_of(8, 8)),)
    assert running.pool.jobs[0].options.session == SessionOptions()


async def test_a_quaternion_that_is_a_little_off_is_made_unit(running: RunningService) -> None:
    rounded = {"x": 0.0, "y": 0.0, "z": 0.5, "w": 0.87}
    assert (await ask(running, 1, {"cameras": [entry(quaternion=rounded)]})).status_code == 200
    (image,) = running.pool.jobs[0].images
    assert image.session_from_camera is not None
    assert math.hypot(*image.session_from_camera.quaternion_xyzw) == pytest.approx(1, abs=1e-12)


async def test_the_most_images_are_taken_and_one_more_is_refused(running: RunningService) -> None:
    assert (await ask(running, MAX_IMAGES, {"cameras": [entry()] * MAX_IMAGES})).status_code == 200
    reply = await ask(running, MAX_IMAGES + 1, {"cameras": [entry()] * MAX_IMAGES})
    problem = reply.json()
    assert (reply.status_code, problem["fields"][0]["field"]) == (422, "image")
    assert "at most 32 parts" in problem["detail"]
    assert len(running.pool.jobs) == 1


@pytest.mark.slow
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
        (
            1,
            {"cameras": [entry(quaternion={"x": 0, "y": 0, "z": 0, "w": 2})]},
            "cameras.0.session_from_camera.quaternion",
            "norm 2",
        ),
        (
            1,
            {"cameras": [entry(quaternion={"x": 0, "y": 0, "z": 0, "w": 0})]},
            "cameras.0.session_from_camera.quaternion",
            "unit quaternion {x, y, z, w}",
        ),
        (
            1,
            {"cameras": [entry(math.nan)]},
            "cameras.0.session_from_camera.position_m.x",
            "finite",
        ),
        (1, {"cameras": [entry(1e30)]}, "cameras.0.session_from_camera.position_m.x", "at most"),
        (1, {"cameras": [entry(position_m={"x": 0, "y": 0})]}, "cameras.0.session_from_camera.position_m.z", "expected a value"),
        (
            1,
            {"cameras": [entry(quaternion={"x": math.inf, "y": 0, "z": 0, "w": 1})]},
            "cameras.0.session_from_camera.quaternion.x",
            "finite",
        ),
        (1, {"cameras": [entry()], "session": {"position_noise_m": -0.1}}, "session.position_noise_m", "at least"),
        (1, {"cameras": [entry()], "session": {"position_noise_m": 1.1}}, "session.position_noise_m", "at most"),
        (1, {"cameras": [entry()], "session": {"orientation_noise_deg": math.nan}}, "session.orientation_noise_deg", "finite"),
        (1, {"cameras": [entry()], "session": {"orientation_noise_deg": 31}}, "session.orientation_noise_deg", "at most"),
        (1, {"cameras": [entry()], "session": {"up": "maybe"}}, "session.up", "'known'"),
        (1, {"cameras": [entry(hfov_deg=math.nan)]}, "cameras.0.hfov_deg", "finite"),
    ],
)  # fmt: skip
async def test_what_does_not_belong_together_is_refused_by_its_field(
    running: RunningService, num_images: int, options: dict[str, Any], field: str, says: str
) -> None:
    reply = await ask(running, num_images, options)
    problem = reply.json()
    assert (reply.status_code, problem["type"]) == (422, "/problems/invalid-options"), problem
    assert field in [each["field"] for each in problem["fields"]]
    assert says in problem["detail"]
    assert running.pool.jobs == []
    assert (await ask(running, 1, {})).status_code == 200


async def test_masks_are_one_or_as_many_as_the_images(running: RunningService) -> None:
    reply = await ask(running, 3, {"cameras": [entry()] * 3}, num_masks=2)
    assert (reply.status_code, reply.json()["fields"][0]["field"]) == (422, "mask")
    assert "one for all, or one per image (3), got 2" in reply.json()["detail"]


async def test_all_images_together_have_no_more_pixels_than_one_may_have(running: RunningService) -> None:
    reply = await ask(running, 4, {"cameras": [entry()] * 4}, sides=6000)
    problem = reply.json()
    assert (reply.status_code, problem["type"]) == (413, "/problems/too-many-pixels")
    assert "4 files together" in problem["detail"]
    assert "PANOLOC_MAX_PIXELS" in problem["detail"]
    assert running.pool.jobs == []


async def test_a_file_that_is_no_image_is_said_to_be_the_second_of_three(running: RunningService) -> None:
    files: list[tuple[str, Any]] = [("map_id", (None, await running.ready_map()))]
    files += [("image", ("a.png", data)) for data in (png_of(8, 8), b"some text", png_of(8, 8))]
    files.append(("options", (None, json.dumps({"cameras": [entry()] * 3}))))
    reply = await running.client.post("/localize", files=files)
    assert (reply.status_code, reply.json()["type"]) == (415, "/problems/unknown-image-format")
    assert "(image 2 of 3)" in reply.json()["detail"]


async def test_all_images_of_a_session_are_kept_when_the_operator_says_so(running: RunningService) -> None:
    localizations = running.app.state.services.localizations
    localizations._settings = localizations._settings.model_copy(update={"keep_images": True})
    body = (await ask(running, 2, {"cameras": [entry(), entry()]})).json()
    assert sorted(running.storage.names("panoramas")) == [f"{body['id']}-01.png", f"{body['id']}-02.png"]


async def test_the_example_of_the_description_is_taken(running: RunningService) -> None:
    assert (await ask(running, 2, SESSION_EXAMPLE)).status_code == 200
