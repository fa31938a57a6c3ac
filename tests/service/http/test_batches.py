"""Batches over HTTP: uploads, progress, results, restarts, exports, deletion, and what is refused."""

import asyncio
import io
import json
import zipfile
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from panoloc.core.errors import DeadlineExceededError, PanoramaShapeError
from panoloc.core.geometry.pose import Pose
from panoloc.service.errors import QueueFullError, StorageFullError
from panoloc.service.http.schemas.batches import Batch, BatchPage
from panoloc.service.jobs import PoolState
from panoloc.service.storage import FolderStorage
from tests.core.image.picture_files import encoded, heic, phone_exif, photo_file, picture
from tests.service.http.fake_pool import IN_UTM, no_worker, outcome_of
from tests.service.http.running_service import SCAN, RunningService, Serve, png_of

pytestmark = pytest.mark.anyio

PNG = png_of(8, 4)


def zipped(**entries: bytes) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for name, data in entries.items():
            archive.writestr(name.replace("__", "/").replace("_", "."), data)
    return out.getvalue()


async def export(running: RunningService, batch_id: str, name: str, **query: str) -> zipfile.ZipFile:
    reply = await running.client.get(f"/batches/{batch_id}/export", params={"format": name, **query})
    assert reply.status_code == 200, reply.text
    assert reply.headers["content-type"] == "application/zip"
    assert int(reply.headers["content-length"]) == len(reply.content)
    return zipfile.ZipFile(io.BytesIO(reply.content))


async def test_every_image_of_a_batch_is_localized_once_and_its_answer_is_that_of_a_query(
    running: RunningService,
) -> None:
    map_id = await running.ready_map()
    options = '{"frame": "webxr", "hints": {"upright": true}}'
    reply = await running.post_batch(map_id, "a.png", "b.png", "a.png", options=options)
    assert reply.status_code == 202, reply.text
    body = reply.json()
    Batch.model_validate(body)
    assert reply.headers["location"] == f"/batches/{body['id']}"
    assert (body["status"], body["num_images"], body["counts"]["waiting"]) == ("queued", 3, 3)
    body = await running.done(body["id"])
    Batch.model_validate(body)
    assert [item["name"] for item in body["items"]] == ["a.png", "b.png", "a-2.png"]
    assert [item["status"] for item in body["items"]] == ["localized"] * 3
    assert body["progress"] == 1
    assert {item["answer"]["pose"]["frame"] for item in body["items"]} == {"webxr"}
    assert len(running.pool.jobs) == 3
    for job in running.pool.jobs:
        assert job.images[0].data == PNG
        assert job.options.hints is not None
        assert job.options.hints.upright


async def test_a_zip_is_unpacked_and_what_is_no_image_is_named(running: RunningService) -> None:
    map_id = await running.ready_map()
    archive = zipped(hall__1_png=PNG, notes_txt=b"hello")
    reply = await running.client.post("/batches", files={"archive": ("photos.zip", archive)}, data={"map_id": map_id})
    assert reply.status_code == 202, reply.text
    body = await running.done(reply.json()["id"])
    assert ([item["name"] for item in body["items"]], body["ignored"]) == (["hall/1.png"], ["notes.txt"])
    assert list((running.data_dir / "uploads").iterdir()) == []


@pytest.mark.parametrize(
    ("files", "options", "name"),
    [
        ([("image", ("a/1.png", PNG)), ("image", ("a/2.png", PNG))], {}, "a"),
        ([("archive", ("north wing.zip", zipped(x__1_png=PNG)))], {}, "north wing"),
        ([("archive", ("north wing.zip", zipped(x__1_png=PNG)))], {"name": "Roof"}, "Roof"),
        ([("image", ("a/1.png", PNG)), ("image", ("2.png", PNG))], {}, "Photos of 20"),
    ],
)
async def test_a_batch_has_the_name_it_is_given_or_that_of_what_its_images_came_in(
    running: RunningService, files: list[Any], options: dict[str, str], name: str
) -> None:
    data = {"map_id": await running.ready_map(), "options": json.dumps(options)}
    made = (await running.client.post("/batches", files=files, data=data)).json()
    assert made["name"].startswith(name)
    assert (await running.json("/batches"))["items"][-1]["name"] == made["name"]


async def test_a_batch_that_is_renamed_keeps_name_and_results_after_a_restart(serve: Serve) -> None:
    async with serve() as running:
        _, batch_id = await running.placed("a.png")
        reply = await running.client.patch(f"/batches/{batch_id}", json={"name": "3rd floor"})
        assert (reply.status_code, reply.json()["name"], reply.json()["progress"]) == (200, "3rd floor", 1), reply.text
        assert await running.status("PATCH", f"/batches/{batch_id}", json={"name": ""}) == 422
        assert await running.status("PATCH", "/batches/batch_0000000000000000", json={"name": "x"}) == 404
    async with serve() as running:
        batch = await running.json(f"/batches/{batch_id}")
        assert (batch["name"], batch["counts"]["localized"]) == ("3rd floor", 1)


async def test_images_that_come_with_their_answers_keep_them_and_only_the_others_are_localized(
    running: RunningService,
) -> None:
    map_id = await running.ready_map()
    answer = (await running.client.post("/localize", files={"image": ("a.png", PNG)}, data={"map_id": map_id})).json()
    assert len(running.pool.jobs) == 1
    options = json.dumps({"answers": [answer["id"], None, "loc_gone"]})
    body = await running.done(
        (await running.post_batch(map_id, "a.png", "b.png", "c.png", options=options)).json()["id"]
    )
    assert [item["status"] for item in body["items"]] == ["localized"] * 3
    assert body["items"][0]["answer"]["id"] == answer["id"]
    assert len(running.pool.jobs) == 3
    wrong = await running.post_batch(map_id, "a.png", "b.png", options=json.dumps({"answers": [answer["id"]]}))
    assert (wrong.status_code, wrong.json()["fields"][0]["field"]) == (422, "answers")


async def test_small_copies_of_images_are_upright_and_one_that_is_none_is_refused(running: RunningService) -> None:
    map_id = await running.ready_map()
    turned = photo_file(picture(64, 32), orientation=6)
    bad = {
        "text.png": b"no image at all",
        "empty.png": b"",
        "cut.jpg": turned[:20],
        "short.jpg": turned[: len(turned) // 2],
    }
    files = [("image", ("a.jpg", turned)), *(("image", file) for file in bad.items())]
    batch_id = (await running.client.post("/batches", files=files, data={"map_id": map_id})).json()["id"]
    small = await running.client.get(f"/batches/{batch_id}/images/0", params={"max_side": 40})
    assert small.headers["content-type"] == "image/jpeg"
    assert Image.open(io.BytesIO(small.content)).size == (20, 40)
    said = [await running.client.get(f"/batches/{batch_id}/images/{n}", params={"max_side": 40}) for n in range(1, 5)]
    assert [each.status_code for each in said] == [415, 415, 422, 422]
    words = ("got text ('no image at all')", "got an empty file", "ends within its header", "ends early or is damaged")
    for each, expected in zip(said, words, strict=True):
        assert expected in each.json()["detail"]
        assert "BytesIO" not in each.text


async def test_batches_are_listed_page_by_page_oldest_first(running: RunningService) -> None:
    made = [(await running.placed(f"{number}.png"))[1] for number in range(3)]
    BatchPage.model_validate(await running.json("/batches"))
    listed = await running.pages("/batches")
    assert [each["id"] for each in listed] == made
    assert {(each["status"], each["progress"], each["num_images"]) for each in listed} == {("done", 1.0, 1)}
    await running.client.delete(f"/batches/{made[0]}")
    assert [each["id"] for each in (await running.json("/batches"))["items"]] == made[1:]
    wrong = await running.client.get("/batches", params={"cursor": "x"})
    assert (wrong.status_code, wrong.json()["fields"][0]["field"]) == (422, "cursor")


async def test_images_come_page_by_page(running: RunningService) -> None:
    names = [f"{number}.png" for number in range(5)]
    _, batch_id = await running.placed(*names)
    assert [item["name"] for item in await running.pages(f"/batches/{batch_id}")] == names
    counts = (await running.client.get(f"/batches/{batch_id}", params={"limit": 0})).json()
    assert (counts["items"], counts["counts"]["localized"]) == ([], 5)
    wrong = await running.client.get(f"/batches/{batch_id}", params={"cursor": "x"})
    assert (wrong.status_code, wrong.json()["fields"][0]["field"]) == (422, "cursor")


async def test_an_image_that_cannot_be_localized_fails_alone(running: RunningService) -> None:
    map_id = await running.ready_map()
    files = [("image", ("a.png", PNG)), ("image", ("text.png", b"no image at all")), ("image", ("b.png", PNG))]
    running.pool.fail_localize = [PanoramaShapeError("image: expected 2:1, got 3:2")]
    reply = await running.client.post("/batches", files=files, data={"map_id": map_id})
    body = await running.done(reply.json()["id"])
    assert Counter(item["status"] for item in body["items"]) == {"failed": 2, "localized": 1}
    (text,) = [item for item in body["items"] if item["name"] == "text.png"]
    assert text["error"]["status"] == 415
    assert body["counts"] == {"waiting": 0, "localized": 1, "ambiguous": 0, "not_localized": 0, "failed": 2}


async def test_what_is_only_a_matter_of_time_is_tried_again(running: RunningService) -> None:
    map_id = await running.ready_map()
    running.pool.fail_localize = [no_worker(), QueueFullError("full", 0)]
    body = await running.done((await running.post_batch(map_id, "a.png")).json()["id"])
    assert body["counts"]["localized"] == 1
    assert len(running.pool.jobs) == 3


@pytest.mark.parametrize(("num_deadlines", "status"), [(2, "localized"), (3, "failed")])
async def test_a_deadline_that_passes_while_an_index_is_built_anew_is_not_the_end_of_an_image(
    running: RunningService, num_deadlines: int, status: str
) -> None:
    map_id = await running.ready_map()
    running.pool.fail_localize = [DeadlineExceededError("no answer within timeout_s")] * num_deadlines
    body = await running.done((await running.post_batch(map_id, "a.png")).json()["id"])
    assert body["items"][0]["status"] == status
    assert len(running.pool.jobs) == 3


@pytest.mark.parametrize(("asked", "timeout_s"), [({}, 600.0), ({"options": '{"timeout_s": 45}'}, 45.0)])
async def test_nobody_waits_for_an_image_so_it_may_take_as_long_as_a_query_may(
    running: RunningService, asked: dict[str, str], timeout_s: float
) -> None:
    map_id = await running.ready_map()
    await running.done((await running.post_batch(map_id, "a.png", **asked)).json()["id"])
    assert [job.options.timeout_s for job in running.pool.jobs] == [timeout_s]


@pytest.mark.slow
async def test_a_batch_waits_while_a_query_waits(running: RunningService, monkeypatch: pytest.MonkeyPatch) -> None:
    map_id = await running.ready_map()
    busy = PoolState(ready=True, waiting_for=None, num_workers=2, queue_depth=1)
    monkeypatch.setattr(running.pool, "state", lambda: busy)
    batch_id = (await running.post_batch(map_id, "a.png", "b.png", "c.png")).json()["id"]
    await asyncio.sleep(0.2)
    assert running.pool.jobs == []
    running.pool.localize_gate.clear()
    monkeypatch.setattr(running.pool, "state", lambda: PoolState(ready=True, waiting_for=None, num_workers=2))
    await asyncio.sleep(0.2)
    assert len(running.pool.jobs) == 2  # one per worker
    running.pool.localize_gate.set()
    await running.done(batch_id)


async def test_after_a_restart_what_is_done_stays_done_and_the_rest_is_taken_up(tmp_path: Path, serve: Serve) -> None:
    async with serve() as first:
        map_id, batch_id = await first.placed("a.png")
        first.pool.localize_gate.clear()
        second_id = (await first.post_batch(map_id, "b.png", "c.png")).json()["id"]
        await asyncio.sleep(0.1)
        first_answer = await first.json(f"/batches/{batch_id}")
    # An upload that was cut off by a crash: images without a record.
    (tmp_path / "batches" / "batch_cut" / "images").mkdir(parents=True)
    async with serve() as again:
        assert await again.json(f"/batches/{batch_id}") == first_answer
        body = await again.done(second_id)
        assert body["counts"]["localized"] == 2
        assert len(again.pool.jobs) == 2
        assert not (tmp_path / "batches" / "batch_cut").exists()


async def test_a_batch_that_is_killed_in_the_middle_does_nothing_twice(tmp_path: Path, serve: Serve) -> None:
    async with serve() as first:
        _, batch_id = await first.placed(*(f"{number}.png" for number in range(4)))
    # As a kill leaves it: two results were there, a third was being written.
    results = tmp_path / "batches" / batch_id / "results"
    for name in ("00002.json", "00003.json"):
        (results / name).unlink()
    (results / ".00002.json.0123.tmp").write_bytes(b'{"sta')
    async with serve() as again:
        body = await again.done(batch_id)
        assert body["counts"]["localized"] == 4
        assert sorted(job.request_id for job in again.pool.jobs) == [f"{batch_id}-00002", f"{batch_id}-00003"]


async def test_a_result_that_the_disk_has_damaged_is_worked_out_again(tmp_path: Path, serve: Serve) -> None:
    async with serve() as first:
        _, batch_id = await first.placed("a.png", "b.png", "c.png")
        as_it_was = await first.json(f"/batches/{batch_id}")
    results = tmp_path / "batches" / batch_id / "results"
    (results / "00001.json").write_bytes((results / "00001.json").read_bytes().replace(b"0.93", b"0.39"))
    (results / "00002.json").write_bytes(b'{"sta')
    async with serve(is_held=True) as again:
        page = await again.json(f"/batches/{batch_id}")
        assert [item["status"] for item in page["items"]] == ["localized", "waiting", "waiting"]
        again.pool.localize_gate.set()
        body = await again.done(batch_id)
        assert sorted(job.request_id for job in again.pool.jobs) == [f"{batch_id}-00001", f"{batch_id}-00002"]
        assert body["items"][0] == as_it_was["items"][0]
        assert {item["answer"]["confidence"] for item in body["items"]} == {0.93}
        (results / "00000.json").write_bytes(b"[]")
        assert await again.status("GET", f"/batches/{batch_id}/export?format=tum") == 200
        await again.done(batch_id)
        assert len(again.pool.jobs) == 3


async def test_a_result_that_is_written_anew_while_it_is_read_is_not_worked_out_again(
    running: RunningService, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, batch_id = await running.placed("a.png")
    store, loop, told = running.app.state.services.batches, asyncio.get_running_loop(), list[object]()
    result = (await store.results(batch_id, [0]))[0]
    store.redo = told.append

    def overtaken(of: str, numbers: list[int], by_hand: set[int]) -> dict[int, None]:
        """Read a damaged result, which is replaced before the reader can tell."""
        asyncio.run_coroutine_threadsafe(store.put_result(of, 0, result), loop).result(10)
        return dict.fromkeys(numbers)

    with monkeypatch.context() as patch:
        patch.setattr(store._files, "read_results", overtaken)
        assert await store.results(batch_id, [0]) == {}
    assert told == []
    assert await store.results(batch_id, [0]) == {0: result}


@pytest.mark.parametrize("error", [OSError(5, "Input/output error"), StorageFullError("no space", 0)])
async def test_a_disk_that_fails_for_a_while_ends_no_batch(
    running: RunningService, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    map_id = await running.ready_map()
    monkeypatch.setattr("panoloc.service.batches.runs._FIRST_PAUSE_S", 0.01)
    left = {"names": 2, "read": 2, "replace": 2}
    whole = {name: getattr(FolderStorage, name) for name in left}

    def failing(name: str) -> Any:
        def call(storage: FolderStorage, key: str, *data: bytes) -> Any:
            wanted = {"names": key.endswith("/results"), "read": "/images/" in key, "replace": "/results/" in key}[name]
            if wanted and left[name] > 0:
                left[name] -= 1
                raise error
            return whole[name](storage, key, *data)

        return call

    running.pool.localize_gate.clear()
    batch_id = (await running.post_batch(map_id, "a.png", "b.png")).json()["id"]
    for name in left:
        monkeypatch.setattr(FolderStorage, name, failing(name))
    running.pool.localize_gate.set()
    await running.done(batch_id)
    assert left["replace"] == 0
    body = await running.json(f"/batches/{batch_id}")
    assert body["counts"]["localized"] == 2


async def test_deleting_a_batch_cancels_it_and_leaves_nothing(running: RunningService) -> None:
    map_id = await running.ready_map()
    running.pool.localize_gate.clear()
    batch_id = (await running.post_batch(map_id, "a.png", "b.png")).json()["id"]
    await asyncio.sleep(0.1)
    assert await running.status("DELETE", f"/batches/{batch_id}") == 204
    assert running.pool.ended == ["localize"]
    assert not (running.data_dir / "batches" / batch_id).exists()
    for call in ("get", "delete"):
        assert (await getattr(running.client, call)(f"/batches/{batch_id}")).status_code == 404
    # The place of what was cancelled is free again.
    running.pool.localize_gate.set()
    await running.done((await running.post_batch(map_id, "a.png")).json()["id"])


async def test_a_map_that_is_deleted_while_its_batch_runs_fails_the_rest_and_what_is_placed_stays(
    running: RunningService,
) -> None:
    map_id, batch_id = await running.placed("a.png")
    running.pool.localize_gate.clear()
    later = (await running.post_batch(map_id, "b.png", "c.png", "d.png")).json()["id"]
    assert await running.status("DELETE", f"/maps/{map_id}") == 204
    running.pool.localize_gate.set()
    body = await running.done(later)
    failed = [item["error"] for item in body["items"] if item["status"] == "failed"]
    assert len(failed) >= 2
    assert {error["type"] for error in failed} == {"/problems/map-not-found"}
    rows = (await export(running, batch_id, "potree")).read("coordinates.txt").decode().splitlines()
    assert [row.split("\t")[0] for row in rows[1:]] == ["a.png"]
    model = await export(running, batch_id, "colmap")
    assert "points3D.txt" in model.namelist()
    assert "the map was deleted" in json.loads(model.read("export.json"))["lacks"]
    assert "the map was deleted" in model.read("unplaced.txt").decode()


@pytest.mark.parametrize("path", ["export?format=plan&", "plan.png?"])
async def test_a_map_that_is_none_of_the_batch_is_refused_with_those_that_are(
    running: RunningService, path: str
) -> None:
    other = await running.ready_map()
    map_id, batch_id = await running.placed("a.png")
    for wrong in ("map_nope", other):
        reply = await running.client.get(f"/batches/{batch_id}/{path}map_id={wrong}")
        assert (reply.status_code, map_id in reply.json()["detail"]) == (422, True)
    assert await running.status("DELETE", f"/maps/{map_id}") == 204
    assert await running.status("GET", f"/batches/{batch_id}/{path}map_id={map_id}") == 200


@pytest.mark.parametrize(("name", "saved"), [("Büro / 2. Stock", "B_ro_2._Stock-tum.zip"), ("…", "-tum.zip")])
async def test_an_export_is_saved_under_the_name_of_its_batch(running: RunningService, name: str, saved: str) -> None:
    _, batch_id = await running.placed("a.png")
    await running.client.patch(f"/batches/{batch_id}", json={"name": name})
    headers = (await running.client.get(f"/batches/{batch_id}/export", params={"format": "tum"})).headers
    assert headers["Content-Disposition"].endswith(f'{saved}"')
    assert ("batch_" in headers["Content-Disposition"]) == (name == "…")


async def test_photos_are_exported_with_those_that_have_no_pose_beside(running: RunningService) -> None:
    map_id = await running.ready_map()
    running.pool.fail_localize = [PanoramaShapeError("image: expected 2:1, got 3:2")]
    batch_id = (await running.post_batch(map_id, "a.png", "b.png")).json()["id"]
    items = (await running.done(batch_id))["items"]
    failed = next(item["name"] for item in items if item["status"] == "failed")
    (placed,) = {"a.png", "b.png"} - {failed}
    archive = await export(running, batch_id, "potree")
    assert json.loads(archive.read("export.json"))["lacks"] is None
    assert archive.testzip() is None
    lines = archive.read("coordinates.txt").decode().splitlines()
    assert [line.split("\t")[0] for line in lines[1:]] == [placed]
    assert lines[1].split("\t")[2:] == ["1.2", "0.3", "1.5", "90", "0", "0"]
    assert archive.read("unplaced.txt").decode() == f"{failed}\tfailed: image: expected 2:1, got 3:2\n"
    model = await export(running, batch_id, "colmap")
    assert b"EQUIRECTANGULAR 8 4 8 4" in model.read("cameras.txt")
    assert len(model.read("points3D.txt").splitlines()) == 11  # of the map: ten points and a comment
    assert list((running.data_dir / "uploads").iterdir()) == []


async def test_photos_that_browsers_and_other_systems_cannot_read_come_back_as_jpeg(running: RunningService) -> None:
    map_id = await running.ready_map()
    archive = zipped(hall__a_heic=heic(picture(128, 64), phone_exif()), b_avif=encoded(picture(128, 64), "AVIF"))
    reply = await running.client.post("/batches", files={"archive": archive}, data={"map_id": map_id})
    batch_id = reply.json()["id"]
    assert [item["status"] for item in (await running.done(batch_id))["items"]] == ["localized"] * 2
    for number in (0, 1):
        image = await running.client.get(f"/batches/{batch_id}/images/{number}")
        assert (image.headers["content-type"], image.content[:3]) == ("image/jpeg", b"\xff\xd8\xff")
        with Image.open(io.BytesIO(image.content)) as opened:
            assert opened.size == (128, 64)
    listed = await export(running, batch_id, "potree")
    rows = listed.read("coordinates.txt").decode().splitlines()[1:]
    assert [row.split("\t")[0] for row in rows] == ["hall/a.heic.jpg", "b.avif.jpg"]
    assert listed.read("hall/a.heic.jpg").startswith(b"\xff\xd8\xff")
    marked = await export(running, batch_id, "navvis")
    assert b"00000-pano.jpg; hall/a.heic.jpg" in marked.read("names.csv")


async def test_the_plan_of_a_batch_is_a_picture(running: RunningService) -> None:
    _, batch_id = await running.placed("a.png", "b.png")
    reply = await running.client.get(f"/batches/{batch_id}/plan.png")
    assert (reply.status_code, reply.headers["content-type"]) == (200, "image/png"), reply.text
    assert reply.content.startswith(b"\x89PNG")
    assert list((running.data_dir / "uploads").iterdir()) == []
    assert await running.status("GET", "/batches/batch_none/plan.png") == 404


@pytest.mark.slow
async def test_a_format_of_places_on_earth_needs_a_georeference(running: RunningService) -> None:
    map_id, batch_id = await running.placed("a.png")
    reply = await running.client.get(f"/batches/{batch_id}/export", params={"format": "geojson"})
    assert (reply.status_code, reply.json()["type"]) == (422, "/problems/export-refused")
    assert "georeference" in reply.json()["detail"]
    assert f"PATCH /maps/{map_id}" in reply.json()["detail"]
    place = {"georeference": {"latitude_deg": 47.7, "longitude_deg": -122.3}}
    assert (await running.client.patch(f"/maps/{map_id}", json=place)).status_code == 200
    found = json.loads((await export(running, batch_id, "geojson")).read("photos.geojson"))
    longitude, latitude, _ = found["features"][0]["geometry"]["coordinates"]
    assert (longitude, latitude) == (pytest.approx(-122.3, abs=1e-4), pytest.approx(47.7, abs=1e-4))
    assert (await running.client.patch(f"/maps/{map_id}", json={"georeference": None})).status_code == 200
    running.pool.bounds, taken = IN_UTM, Pose(np.eye(3), np.array([691_006.0, 5_335_004.0, 501.5]))
    running.pool.outcome_of = lambda job: outcome_of(job, taken)
    map_id, batch_id = await running.placed("a.png")
    assert (await running.client.patch(f"/maps/{map_id}", json={"coordinate_system": "EPSG:25832"})).status_code == 200
    found = json.loads((await export(running, batch_id, "stac")).read("items.json"))
    assert found["features"][0]["properties"]["pers:crs"] == 25832
    assert await running.status("GET", f"/batches/{batch_id}/export", params={"format": "kml"}) == 422


@pytest.mark.slow
async def test_an_export_as_e57_holds_the_e57_that_the_map_was_made_of(running: RunningService, tmp_path: Path) -> None:
    from pye57 import E57

    file = E57(str(tmp_path / "station.e57"), mode="w")
    columns = {f"cartesian{axis}": np.linspace(0, 9, 50) for axis in "XYZ"}
    file.write_scan_raw(
        columns, name="the station", rotation=np.array([1.0, 0, 0, 0]), translation=np.array([7.0, 8, 9])
    )
    file.close()
    scan = (tmp_path / "station.e57").read_bytes()
    for options, name in ((None, "the station"), ('{"unit": "cm"}', "map")):
        map_id = (await running.upload(scan, "station.e57", options)).json()["id"]
        await running.settled(map_id)
        _, batch_id = await running.placed("a.png", map_id=map_id)
        (await export(running, batch_id, "e57")).extractall(tmp_path / name)
        found = E57(str(tmp_path / name / "tour.e57"))
        assert found.root["data3D"][0]["name"].value() == name
        assert found.root["images2D"][0]["name"].value() == "a.png"
        found.close()
    # A name alone makes no E57.
    map_id = (await running.upload(SCAN, "room.e57")).json()["id"]
    await running.settled(map_id)
    _, batch_id = await running.placed("a.png", map_id=map_id)
    assert (await export(running, batch_id, "e57")).namelist()[0] == "tour.e57"


IMAGE, HERE = {"image": ("a.png", PNG)}, {"map_id": "MAP"}


@pytest.mark.parametrize(
    ("files", "data", "status", "problem"),
    [
        (IMAGE, {}, 422, "map_id"),
        (None, HERE, 400, "boundary"),
        (IMAGE | {"archive": ("a.zip", zipped(a_png=PNG))}, HERE, 422, "both"),
        ({"archive": ("a.zip", PNG)}, HERE, 422, "expected a zip"),
        ({"archive": ("a.zip", zipped(notes_txt=b"x"))}, HERE, 422, "without any"),
        (IMAGE, {"map_id": "map_none"}, 404, "map_none"),
        (IMAGE, HERE | {"options": '{"artifacts": ["overlay"]}'}, 422, "artifacts"),
        (IMAGE, HERE | {"options": '{"timeout_s": 9999}'}, 422, "timeout_s"),
        ({"scan": ("a.png", PNG)}, HERE, 422, "scan"),
    ],
)
async def test_what_is_no_batch_is_refused_and_leaves_nothing(
    running: RunningService, files: dict[str, Any] | None, data: dict[str, str], status: int, problem: str
) -> None:
    map_id = await running.ready_map()
    data = {name: map_id if value == "MAP" else value for name, value in data.items()}
    reply = await running.client.post("/batches", files=files, data=data)
    assert (reply.status_code, problem in reply.json()["detail"]) == (status, True), reply.text
    assert not list((running.data_dir).glob("batches/*"))
    assert not list((running.data_dir).glob("uploads/*"))


async def test_limits_of_batches_and_of_their_images_are_named(
    tmp_path: Path,
    serve: Serve,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("panoloc.service.services.MOST_BATCHES", 1)
    limits = {"max_batch_images": 2, "max_image_bytes": 1000}
    async with serve(**limits) as running:
        map_id = await running.ready_map()
        reply = await running.post_batch(map_id, "a.png", "b.png", "c.png")
        assert (reply.status_code, "at most 2 parts" in reply.text) == (422, True)
        large = [("image", ("a.png", PNG)), ("image", ("b.png", PNG + b"x" * 1000))]
        reply = await running.client.post("/batches", files=large, data={"map_id": map_id})
        assert (reply.status_code, "PANOLOC_MAX_IMAGE_BYTES" in reply.text) == (413, True)
        assert not list(tmp_path.glob("uploads/*"))
        archive = zipped(a_png=PNG, b_png=PNG, c_png=PNG)
        reply = await running.client.post("/batches", files={"archive": ("a.zip", archive)}, data={"map_id": map_id})
        assert (reply.status_code, "PANOLOC_MAX_BATCH_IMAGES" in reply.text) == (413, True)
        assert (await running.post_batch(map_id, "a.png")).status_code == 202
        reply = await running.post_batch(map_id, "a.png")
        assert (reply.status_code, "fewer than 1 batches" in reply.text) == (409, True)


async def test_uploads_at_the_same_time_make_no_more_batches_than_allowed(
    tmp_path: Path,
    serve: Serve,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("panoloc.service.services.MOST_BATCHES", 2)
    async with serve() as running:
        map_id = await running.ready_map()
        replies = await asyncio.gather(*(running.post_batch(map_id, "a.png") for _ in range(5)))
        assert sorted(reply.status_code for reply in replies) == [202, 202, 409, 409, 409]
        assert len(list(tmp_path.glob("batches/*"))) == 2
        assert not list(tmp_path.glob("uploads/*"))


async def test_no_more_than_two_exports_are_written_at_the_same_time(
    running: RunningService, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, batch_id = await running.placed("a.png")
    under_way, most = 0, 0

    async def counted(module: str, tour: str, name: str, target: str, **_: object) -> tuple[int, str]:
        nonlocal under_way, most
        under_way += 1
        most = max(most, under_way)
        await asyncio.sleep(0.05)
        Path(target).write_bytes(b"zip")
        under_way -= 1
        return 0, ""

    monkeypatch.setattr("panoloc.service.host.written_files.run_module", counted)
    path = f"/batches/{batch_id}/export?format=tum"
    replies = await asyncio.gather(*(running.client.get(path) for _ in range(5)))
    assert [reply.content for reply in replies] == [b"zip"] * 5
    assert most == 2
