"""Objects that changed, their pictures and reports, over HTTP: from the photos of a batch, in processes of their own."""

import io
import json
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from panoloc.service.host import written_files
from panoloc.service.http.schemas.known_map import MapChanges
from panoloc.service.jobs import ChangePhoto, LocalizeJob, LocalizeOutcome
from panoloc.service.maps.changed_objects import floor_of
from tests.service.http.fake_pool import IN_UTM, outcome_of
from tests.service.http.running_service import RunningService, png_of
from tests.service.maps.test_changes import seen

pytestmark = pytest.mark.anyio

OBJECT = {
    "id": "0123456789ab",
    "kind": "came",
    "center_m": [1.0, 2.0, 3.4],
    "size_m": [0.5, 0.5, 0.8],
    "from_m": None,
    "seen_from_m": [0.0, 0.0, 1.5],
    "certainty": 0.8,
    "is_sure": True,
    "num_photos": 1,
    "first_seen_at": "2026-11-21T12:00:00Z",
    "last_seen_at": "2026-11-21T12:00:00Z",
}


def sees(job: LocalizeJob) -> LocalizeOutcome:
    """Answer as a worker does that keeps a photo where it may."""
    photo = ChangePhoto(webp(), (0.0, 0.0, 1.5), (0.0, 0.0, 0.0, 1.0)) if job.keep_photo else None
    return replace(outcome_of(job), change_cells=seen((0, 0, 0)), change_photo=photo)


def webp() -> bytes:
    file = io.BytesIO()
    Image.new("RGBA", (64, 32), "white").save(file, "WEBP")
    return file.getvalue()


@pytest.fixture
def questions(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, object]]:
    """What the processes that look for objects, and that write reports, are asked; one object is found."""
    asked: list[dict[str, object]] = []

    async def run(module: str, source: str, *others: str, **_: object) -> tuple[int, str]:
        asked.append(json.loads(Path(source).read_text()))
        if module.endswith("reports"):
            Path(others[-1]).write_text(others[0])
            return 0, ""
        with zipfile.ZipFile(others[-1], "w") as archive:
            archive.writestr("objects.json", json.dumps([OBJECT]))
            archive.writestr(f"{OBJECT['id']}.jpg", b"picture")
        return 0, ""

    monkeypatch.setattr(written_files, "run_module", run)
    return asked


async def changed_map(running: RunningService) -> tuple[str, str]:
    """Return a map in which a batch of one photo and a query were answered, and the batch."""
    running.pool.outcome_of = sees
    map_id, batch_id = await running.placed("a.png")
    await running.localize(map_id, png_of(16, 8))
    return map_id, batch_id


async def test_objects_are_found_in_photos_of_batches_alone_and_go_with_them(
    running: RunningService, questions: list[dict[str, object]]
) -> None:
    map_id, batch_id = await changed_map(running)
    path = f"/maps/{map_id}/changes"
    changes = MapChanges.model_validate(await running.json(path))
    assert [each.id for each in changes.objects] == [OBJECT["id"]]
    assert (changes.num_photos, len(changes.answers)) == (1, 2)
    assert (await running.client.get(f"{path}/objects/{OBJECT['id']}.jpg")).content == b"picture"
    assert await running.status("GET", f"{path}/objects/ffffffffffff.jpg") == 404
    assert len(questions) == 1  # found once, remembered
    early = await running.json(path, until="2020-01-01T00:00:00Z")
    assert (early["objects"], early["answers"]) == ([], [])
    assert await running.status("DELETE", f"/batches/{batch_id}") == 204
    left = await running.json(path)
    assert (left["objects"], left["num_photos"], len(left["answers"])) == ([], 0, 2)


async def test_a_batch_that_takes_answers_over_has_the_photos_of_them(
    running: RunningService, questions: list[dict[str, Any]]
) -> None:
    running.pool.outcome_of = sees
    map_id = await running.ready_map()
    answer = (await running.localize(map_id)).json()
    path = f"/maps/{map_id}/changes"
    assert (await running.json(path))["num_photos"] == 0
    options = json.dumps({"answers": [answer["id"]]})
    batch_id = (await running.post_batch(map_id, "a.png", options=options)).json()["id"]
    await running.done(batch_id)
    assert (await running.json(path))["num_photos"] == 1
    (asked,) = questions[-1]["photos"]
    assert asked["position_m"] == list(answer["pose"]["map_from_camera"]["position_m"].values())
    assert asked["image"].endswith(f"batches/{batch_id}/images/00000")
    await running.localize(map_id)  # the same photo again forgets its former answer, not the image of the batch
    assert await running.status("GET", f"/batches/{batch_id}/images/0") == 200
    (await running.post_batch(map_id, "a.png", options=options)).raise_for_status()
    assert await running.status("DELETE", f"/batches/{batch_id}") == 204
    assert (await running.json(path))["num_photos"] == 0


@pytest.mark.parametrize(("wanted", "kind"), [("pdf", "application/pdf"), ("geojson", "application/geo+json")])
async def test_a_report_says_what_was_found_and_where_the_map_is(
    running: RunningService, questions: list[dict[str, object]], wanted: str, kind: str
) -> None:
    map_id, _ = await changed_map(running)
    reply = await running.client.get(f"/maps/{map_id}/changes/report", params={"format": wanted})
    assert (reply.text, reply.headers["content-type"]) == (wanted, kind)
    objects = questions[-1]["objects"]
    assert isinstance(objects, list)
    assert objects[0]["id"] == OBJECT["id"]
    assert "1 photo," in str(questions[-1]["period"])


async def test_a_report_tells_positions_as_the_map_does_on_its_grid_and_on_earth(
    running: RunningService, questions: list[dict[str, Any]]
) -> None:
    running.pool.bounds = IN_UTM
    map_id, _ = await changed_map(running)
    path = f"/maps/{map_id}"
    at = {"x": 1.0, "y": 2.0, "z": 3.4}
    for place in (
        {"coordinate_system": "EPSG:25832"},
        # It takes precedence over the coordinate system; the grid is that of control points, of which there are none.
        {"georeference": {"latitude_deg": 48.0, "longitude_deg": 11.0, "height_m": 500.0, "heading_deg": 90.0}},
    ):
        (await running.client.patch(path, json=place)).raise_for_status()
        (await running.client.get(f"{path}/changes/report")).raise_for_status()
        told = (await running.client.get(f"{path}/coordinates", params=at)).json()
        (found,) = questions[-1]["objects"]
        assert (found["grid"], found["wgs84"], found["from_grid"]) == (told["grid"], told["wgs84"], None)
    assert told["wgs84"]["latitude_deg"] == pytest.approx(48.0, abs=1e-4)


@pytest.mark.parametrize(
    "path", ["/maps/{map}/changes", "/maps/{map}/changes/report", "/batches/{batch}/export?format=e57"]
)
async def test_a_map_that_is_deleted_while_something_is_made_of_it_is_not_found(
    running: RunningService, monkeypatch: pytest.MonkeyPatch, path: str
) -> None:
    map_id, batch_id = await changed_map(running)

    async def run(module: str, source: str, *_: str, **__: object) -> tuple[int, str]:
        assert await running.status("DELETE", f"/maps/{map_id}") == 204
        return 1, f"FileNotFoundError: [Errno 2] No such file or directory: {source!r}"

    monkeypatch.setattr(written_files, "run_module", run)
    reply = await running.client.get(path.format(map=map_id, batch=batch_id))
    assert (reply.status_code, reply.json()["type"]) == (404, "/problems/map-not-found")


async def test_a_process_that_fails_tells_callers_no_path_of_this_machine(
    running: RunningService, monkeypatch: pytest.MonkeyPatch
) -> None:
    map_id, _ = await changed_map(running)

    async def run(module: str, source: str, *_: str, **__: object) -> tuple[int, str]:
        return 1, f"OSError: {source}"

    monkeypatch.setattr(written_files, "run_module", run)
    reply = await running.client.get(f"/maps/{map_id}/changes")
    assert reply.status_code == 500
    assert str(running.data_dir) not in reply.text


async def test_a_map_without_photos_has_an_empty_report(
    running: RunningService, questions: list[dict[str, object]]
) -> None:
    map_id = await running.ready_map()
    assert (await running.client.get(f"/maps/{map_id}/changes/report")).status_code == 200
    assert questions[-1]["objects"] == []
    period = {"since": "2026-11-20", "until": "2026-11-21"}
    await running.client.get(f"/maps/{map_id}/changes/report", params=period)
    words = "No photos are kept from 2026-11-20 00:00 UTC until 2026-11-21 23:59 UTC."
    assert (questions[-1]["num_photos"], questions[-1]["period"]) == (0, words)


@pytest.mark.parametrize(
    ("period", "field", "message"),
    [
        ({"since": "yesterday"}, "since", "such as 2026-11-21"),
        ({"until": "2026-11-21T12:00:00"}, "until", "with its zone"),
        ({"since": "2026-11-22", "until": "2026-11-21"}, "since", "exchange them"),
    ],
)
async def test_a_period_that_cannot_be_is_refused_with_what_to_send(
    running: RunningService, period: dict[str, str], field: str, message: str
) -> None:
    map_id = await running.ready_map()
    reply = await running.client.get(f"/maps/{map_id}/changes", params=period)
    assert (reply.status_code, reply.json()["fields"][0]["field"]) == (422, field)
    assert message in reply.json()["detail"]


def test_an_object_stands_on_the_highest_floor_below_it() -> None:
    levels = {"floors": [{"level_m": 0.0, "height_m": 2.6}, {"level_m": 2.9, "height_m": None}]}
    assert floor_of(OBJECT, levels) == 1
    assert floor_of({**OBJECT, "center_m": [0, 0, 0.3]}, levels) == 0
    assert floor_of(OBJECT, {}) is floor_of(OBJECT, {"floors": []}) is None
