"""Photos placed by hand over HTTP: solved, refined, confirmed, undone, exported, and refused. A fake pool refines to its own pose."""

import io
import json
import math
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from panoloc.core.camera.camera import Camera, CameraDescription
from panoloc.core.camera.lens import project_to_image
from panoloc.core.geometry.pose import Pose
from panoloc.core.options import Status
from panoloc.core.survey.resection import resect
from panoloc.service.batches.hand_evidence import of_pairs
from panoloc.service.http.schemas.batches import BatchItem, HandPlacement
from panoloc.service.jobs import LocalizeJob, LocalizeOutcome
from panoloc.service.keys.caller import Scope
from panoloc.service.keys.key_file import KeyFile
from tests.core.image.picture_files import encoded
from tests.service.http.fake_pool import outcome_of
from tests.service.http.running_service import RunningService, Serve

pytestmark = pytest.mark.anyio
POINTS = np.array([[0.1, 0.2, 2.5], [5.9, 0.3, 0.4], [5.8, 4.9, 2.4], [0.3, 4.7, 0.9]])
SPHERE = Camera("equirectangular", 1000, 500, 500 / math.pi, 500 / math.pi, 500, 250)
PHOTO = encoded(np.zeros((500, 1000, 3), np.uint8), "PNG")
TRUE = Pose(np.eye(3), np.array([2.0, 2.0, 1.5]))
ROUGH = {
    "frame": "ros",
    "map_from_camera": {"position_m": {"x": 1, "y": 0, "z": 1.5}, "quaternion": {"x": 0, "y": 0, "z": 0, "w": 1}},
}


def lost(job: LocalizeJob) -> LocalizeOutcome:
    """Return what a worker says of a photo that it does not find, with a guess."""
    return outcome_of(job, status="not_localized")


def pairs(count: int = 4) -> list[dict[str, Any]]:
    u, v, _ = project_to_image(SPHERE, POINTS[:count] - TRUE.position)
    return [
        {"pixel": [x, y], "position_m": point}
        for x, y, point in zip(u.tolist(), v.tolist(), POINTS.tolist(), strict=False)
    ]


async def lost_photo(
    running: RunningService, outcome: Callable[[LocalizeJob], LocalizeOutcome] = lost
) -> tuple[str, str]:
    """Return the paths of a batch and of the pose of its first photo."""
    running.pool.outcome_of = outcome
    map_id = await running.ready_map()
    files = [("image", (name, PHOTO)) for name in ("a.png", "b.png")]
    batch_id = (await running.client.post("/batches", files=files, data={"map_id": map_id})).json()["id"]
    await running.done(batch_id)
    return f"/batches/{batch_id}", f"/batches/{batch_id}/images/0/pose"


async def test_a_lost_photo_is_placed_by_points_and_counts_as_found_until_that_is_undone(
    running: RunningService,
) -> None:
    batch, path = await lost_photo(running)
    assert (await running.json(batch))["counts"]["not_localized"] == 2
    tried = await running.client.post(path, json={"pairs": pairs(), "refine": False})
    assert tried.status_code == 200, tried.text
    HandPlacement.model_validate(tried.json())
    given = tried.json()["given"]
    assert given["confidence"] <= 0.8  # nothing has compared photo and scan
    assert "were not compared" in given["warnings"][-1]
    assert list(given["pose"]["map_from_camera"]["position_m"].values()) == pytest.approx(TRUE.position, abs=1e-3)
    assert given["residuals_px"] == pytest.approx([0] * 4, abs=0.1)
    assert (tried.json()["refined"], tried.json()["item"]["status"]) == (None, "not_localized")
    confirmed = (await running.client.post(path, json={"pairs": pairs(), "refine": False, "confirm": True})).json()[
        "item"
    ]
    BatchItem.model_validate(confirmed)
    body = await running.json(batch)
    assert body["items"][0] == confirmed
    assert (body["counts"]["localized"], body["counts"]["not_localized"]) == (1, 1)
    answer = confirmed["answer"]
    assert (answer["status"], answer["placed_by"], answer["reasons"]) == ("localized", "hand", ["placed_by_hand"])
    assert "were not compared" in answer["warnings"][0]
    assert 0.5 < answer["confidence"] < 1
    assert 0 < answer["accuracy"]["position_m"] < 0.3
    undone = await running.client.delete(path)
    assert (undone.status_code, undone.json()["status"]) == (200, "not_localized")
    assert (await running.json(batch))["counts"]["localized"] == 0
    assert (await running.client.delete(path)).status_code == 200


def test_a_pair_that_contradicts_the_others_is_named() -> None:
    solved = resect(SPHERE, np.array([each["pixel"] for each in pairs()]), POINTS)
    assert "pair 2 does not fit the others" in of_pairs([replace(solved[0], suspect=1)], 4).warnings[0]


async def test_a_photo_whose_camera_its_answer_tells_is_placed_with_that(running: RunningService) -> None:
    running.pool.outcome_of = lost
    map_id = await running.ready_map()
    photo = ("photo.png", encoded(np.zeros((400, 500, 3), np.uint8), "PNG"))
    camera = {"model": "pinhole", "hfov_deg": 70.0}
    sent = {"map_id": map_id, "options": json.dumps({"cameras": [camera]})}
    answer = (await running.client.post("/localize", files={"image": photo}, data=sent)).json()
    assert answer["images"][0]["camera"] == camera
    sent = {"map_id": map_id, "options": json.dumps({"answers": [answer["id"]]})}
    batch = (await running.client.post("/batches", files={"image": photo}, data=sent)).json()["id"]
    await running.done(batch)
    reply = await running.client.post(f"/batches/{batch}/images/0/pose", json={"pose": ROUGH})
    assert reply.status_code == 200, reply.text
    assert running.pool.jobs[-1].images[0].camera == CameraDescription("pinhole", hfov_deg=70.0)


async def test_a_refined_pose_comes_with_the_field_of_view_that_was_found_for_it(running: RunningService) -> None:
    map_id = await running.ready_map()
    found_camera = CameraDescription("pinhole", hfov_deg=50.0)
    running.pool.outcome_of = lambda job: outcome_of(job, TRUE, found_camera=found_camera)
    photo = ("photo.png", encoded(np.zeros((400, 500, 3), np.uint8), "PNG"))
    sent = {"map_id": map_id, "options": json.dumps({"cameras": [{"model": "pinhole", "hfov_deg": 70.0}]})}
    batch = (await running.client.post("/batches", files={"image": photo}, data=sent)).json()["id"]
    await running.done(batch)
    points = np.array([[6.0, 1.0, 1.0], [6.0, 3.0, 2.0], [5.0, 2.5, 0.8]])
    u, v, _ = project_to_image(found_camera.of_image((500, 400), (500, 400)), points - TRUE.position)
    clicked = [
        {"pixel": [x, y], "position_m": at} for x, y, at in zip(u.tolist(), v.tolist(), points.tolist(), strict=True)
    ]
    placed = (await running.client.post(f"/batches/{batch}/images/0/pose", json={"pairs": clicked})).json()
    assert [placed[which]["camera"]["hfov_deg"] for which in ("given", "refined")] == [70.0, 50.0]
    assert placed["refined"]["rms_px"] < 0.1 < placed["moved_m"]


async def test_a_rough_pose_is_refined_there_alone(running: RunningService) -> None:
    _, path = await lost_photo(running)
    running.pool.jobs.clear()
    found = (await running.client.post(path, json={"pose": ROUGH})).json()
    (job,) = running.pool.jobs
    assert job.options.hints is not None
    assert job.options.hints.prior is not None
    assert (job.options.hints.prior.is_only, job.options.hints.prior.position_m) == (True, (1.0, 0.0, 1.5))
    assert found["refined"]["pose"]["map_from_camera"]["position_m"] == pytest.approx({"x": 1.2, "y": 0.3, "z": 1.5})
    assert found["moved_m"] == pytest.approx(math.hypot(0.2, 0.3))
    assert (found["refined"]["confidence"], found["better"]) == (0.93, "refined")
    assert any("by eye" in words for words in found["refined"]["warnings"])
    assert (found["given"]["confidence"], found["given"]["accuracy"]) == (0, None)
    # One that is farther off than the person said, and that the scan hardly supports, is not taken.
    found = (await running.client.post(path, json={"pose": ROUGH, "position_std_m": 0.2})).json()
    assert found["better"] == "given"


@pytest.mark.parametrize(("x", "outside"), [(12.5, False), (112.4, True)])
async def test_a_pose_outside_of_the_scan_says_so_and_nothing_of_hints(
    running: RunningService, x: float, outside: bool
) -> None:
    def lost_at(job: LocalizeJob) -> LocalizeOutcome:
        found = outcome_of(job, Pose(np.eye(3), np.array([x, 4.0, 1.5])), "not_localized")
        said = {"reasons": ["widen_hints", "check_image"], "warnings": ["widen the hints", "check the image"]}
        return replace(found, answer=found.answer.model_copy(update=said))

    _, path = await lost_photo(running, lost_at)
    there = {"position_m": {"x": x, "y": 4, "z": 1.5}, "quaternion": {"x": 0, "y": 0, "z": 0, "w": 1}}
    body = {"pose": {"frame": "ros", "map_from_camera": there}, "confirm": True}
    answer = (await running.client.post(path, json=body)).json()["item"]["answer"]
    words = " ".join(answer["warnings"])
    assert ("100.0 m outside of the scan" in words) == outside
    assert ("check the image" in words, "hints" in words, "before you confirm" in words) == (True, False, False)
    assert answer["reasons"] == ["placed_by_hand", "check_image"]
    found = (await running.client.post(path, json={**body, "refine": False})).json()
    assert ("outside of the scan" in " ".join(found["given"]["warnings"])) == outside


async def test_a_refined_pose_that_leaves_the_clicked_points_is_doubted(running: RunningService) -> None:
    _, path = await lost_photo(running)
    found = (await running.client.post(path, json={"pairs": pairs()})).json()
    assert (found["refined"]["rms_px"] > 50, found["better"]) == (True, "given")
    assert "confirm the solved pose" in found["refined"]["warnings"][-1]
    for confirm, stored in ((True, "given"), ("refined", "refined"), ("given", "given")):
        found = (await running.client.post(path, json={"pairs": pairs(), "confirm": confirm})).json()
        assert found["item"]["answer"]["pose"] == found[stored]["pose"]
    # Three points always fit: a pose that is sure is worth more.
    running.pool.outcome_of = outcome_of
    for count, better in ((4, "given"), (3, "refined")):
        found = (await running.client.post(path, json={"pairs": pairs(count)})).json()
        assert (found["refined"]["rms_px"] > 50, found["better"]) == (True, better)


async def test_what_was_placed_is_exported_and_outlives_the_service(serve: Serve) -> None:
    async with serve() as running:
        batch, path = await lost_photo(running)
        assert (
            await running.client.post(path, json={"pose": ROUGH, "refine": False, "confirm": True})
        ).status_code == 200
    async with serve() as running:
        body = await running.json(batch)
        assert body["items"][0]["answer"]["placed_by"] == "hand"
        assert body["counts"]["localized"] == 1
        exported = await running.client.get(f"{batch}/export", params={"format": "tum"})
        assert exported.status_code == 200, exported.text
        with zipfile.ZipFile(io.BytesIO(exported.content)) as archive:
            assert "a.png" not in archive.read("unplaced.txt").decode()
            assert json.loads(archive.read("export.json"))["placed_by_hand"] == ["a.png"]
        assert (await running.client.delete(batch)).status_code == 204
        assert not list(running.storage.names("batches"))


async def test_what_cannot_be_placed_is_refused_with_what_to_do(running: RunningService) -> None:
    batch, path = await lost_photo(running)
    in_line = [{"pixel": [100 * x, 250], "position_m": [float(x), 0, 0]} for x in range(1, 4)]
    for body, field in (
        ({}, "body"),
        ({"pose": ROUGH, "pairs": pairs()}, "body"),
        ({"pairs": pairs(2)}, "pairs"),
        ({"pairs": in_line}, "pairs"),
        ({"pairs": [{**each, "pixel": [2000, 100]} for each in pairs()]}, "pairs.0.pixel"),
        ({"pose": {**ROUGH, "frame": "nowhere"}}, "pose.frame"),
        ({"pose": ROUGH, "confirm": "maybe"}, "confirm"),
    ):
        reply = await running.client.post(path, json=body)
        assert (reply.status_code, reply.json()["fields"][0]["field"]) == (422, field), reply.text
    assert (await running.client.post(f"{batch}/images/2/pose", json={"pose": ROUGH})).status_code == 404
    assert (await running.client.post(path, json={"pose": ROUGH, "map_id": "map_unknown"})).status_code == 404


async def test_a_photo_that_still_waits_is_not_placed(serve: Serve) -> None:
    async with serve(is_held=True) as running:
        map_id = await running.ready_map()
        batch_id = (await running.post_batch(map_id, "a.png")).json()["id"]
        reply = await running.client.post(f"/batches/{batch_id}/images/0/pose", json={"pose": ROUGH})
        assert (reply.status_code, reply.json()["fields"][0]["field"]) == (422, "number")
        running.pool.localize_gate.set()


async def test_only_the_tenant_of_a_batch_places_its_photos(serve: Serve, tmp_path: Path) -> None:
    file, scopes = KeyFile(tmp_path), cast(list[Scope], ["read", "localize", "write"])
    ann, bob = (file.make(name, scopes, tenant=name)[1] for name in ("ann", "bob"))
    async with serve() as running:
        _, path = await lost_photo(running.by(ann))
        assert await running.by(bob).status("POST", path, json={"pose": ROUGH}) == 404
        assert await running.by(bob).status("DELETE", path) == 404
        assert await running.status("POST", path, json={"pose": ROUGH}) == 401
        assert await running.by(ann).status("POST", path, json={"pose": ROUGH}) == 200


@pytest.mark.parametrize(
    ("status", "moved_m", "most"), [("localized", 0.1, 0.93), ("not_localized", 0.6, 0.93), ("localized", 0.6, 0.07)]
)
async def test_pairs_count_for_no_more_than_photo_and_scan_agree_there(
    running: RunningService, status: Status, moved_m: float, most: float
) -> None:
    there = Pose(TRUE.rotation, TRUE.position + np.array([moved_m, 0, 0]))
    _, path = await lost_photo(running, lambda job: outcome_of(job, there, status))
    given = (await running.client.post(path, json={"pairs": pairs()})).json()["given"]
    assert given["confidence"] == pytest.approx(most)
    assert "only if they show the right points" in given["warnings"][-1]


async def test_three_pairs_have_nothing_that_checks_them(running: RunningService) -> None:
    _, path = await lost_photo(running)
    given = (await running.client.post(path, json={"pairs": pairs(3), "refine": False})).json()["given"]
    assert (given["confidence"], given["accuracy"]) == (0, None)
    assert "nothing says how accurate" in given["warnings"][0] or "click one more" in given["warnings"][0]
