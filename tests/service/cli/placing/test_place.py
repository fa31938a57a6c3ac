"""A folder of photos: placed, taken up again, and written for other systems."""

import json
import subprocess
from pathlib import Path

import httpx
import numpy as np
import pytest

from panoloc.core.exports.tour import PlacedPhoto, Tour
from panoloc.core.geometry.pose import Pose
from panoloc.service.cli import progress
from panoloc.service.cli.placing.place_folder import PlaceFolder, Question
from tests.core.exports.tours import written
from tests.service.cli.commands import Panoloc
from tests.service.cli.fake_service import READY_MAP, FakeService, answer_with, problem

EXIT_ERROR, EXIT_USAGE, EXIT_NOT_LOCALIZED = 1, 2, 3
IN_SEATTLE = {
    **READY_MAP,
    "georeference": {"latitude_deg": 47.7, "longitude_deg": -122.3, "height_m": 11.5, "heading_deg": 0.0},
}

pytestmark = pytest.mark.usefixtures("photos")


def num_queries(fake: FakeService) -> int:
    return fake.requests.count(("POST", "/localize"))


def rows(file: Path) -> list[list[str]]:
    return [line.split("\t") for line in file.read_text().splitlines()]


def test_every_photo_is_placed_and_written_in_the_formats_asked_for(
    place: Panoloc, fake: FakeService, out: Path
) -> None:
    outcome = place("--export", "potree,colmap", "--upright")
    assert outcome.code == 0, outcome.err
    assert "3 photos: 3 localized" in outcome.out
    assert "warnings" not in outcome.out
    assert "potree (photos: 3)" in " ".join(outcome.err.split())
    assert json.loads(fake.parts["options"][0])["hints"] == {"upright": True}
    table = rows(out / "potree" / "coordinates.txt")[1:]
    assert [row[0] for row in table] == ["hall.jpg", "rooms/a.jpg", "rooms/b.png"]
    assert table[0][2:] == ["1.25", "0.5", "1.5", "90", "0", "0"]  # of the quaternion, not of the angles beside it
    assert (out / "unplaced.txt").read_text() == ""
    assert "1 EQUIRECTANGULAR 64 32 64 32" in (out / "colmap" / "cameras.txt").read_text()
    assert len((out / "colmap" / "points3D.txt").read_text().splitlines()) == 3


def test_photos_that_were_placed_with_warnings_are_named_at_the_end(
    place: Panoloc, fake: FakeService, tmp_path: Path
) -> None:
    told = {**answer_with("localized"), "warnings": ["the pose is for an image 57 degrees wide"]}
    fake.answers = {f"is {name}": told for name in ("hall.jpg", "rooms/b.png")}
    fake.answers["is rooms/a.jpg"] = {**answer_with("not_localized"), "warnings": ["nothing fits"]}
    said = " ".join(place("--out", tmp_path / "warned").out.split())
    assert "placed, with warnings (results/): hall.jpg: the pose is for an image 57 degrees wide and 1 more" in said
    assert "nothing fits" not in said


def test_a_log_is_told_now_and_then_how_far_it_is(
    place: Panoloc, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert "of 3" not in place().err
    monkeypatch.setattr(progress, "LINE_S", 0.0)
    assert "placing: 2 of 3: 2 localized" in place("--out", tmp_path / "slow").err.splitlines()


def test_what_has_no_pose_is_listed_with_its_reason_and_in_no_export(
    place: Panoloc, panoloc: Panoloc, fake: FakeService, out: Path, tmp_path: Path
) -> None:
    fake.refuse_file = "is rooms/b.png"
    fake.answers = {"is hall.jpg": answer_with("ambiguous"), "is rooms/a.jpg": answer_with("not_localized")}
    outcome = place("--export", "potree")
    assert outcome.code == EXIT_ERROR
    assert "potree (photos: 0, left out: 3, see unplaced.txt there)" in " ".join(outcome.err.split())
    expected = [
        [
            "hall.jpg",
            "ambiguous: several places look the same, its best guess with a confidence of 0.93; include "
            "ambiguous photos to export it",
        ],
        ["rooms/a.jpg", "not_localized: no place fits well enough, its best guess with a confidence of 0.93"],
        ["rooms/b.png", "failed: expected 2:1, got 3000 x 2000; crop it."],
    ]
    assert rows(out / "unplaced.txt") == expected
    assert rows(out / "potree" / "unplaced.txt") == expected
    assert len(rows(out / "potree" / "coordinates.txt")) == 1
    more = panoloc("export", out, "--export", "potree,tum", "--include-ambiguous", "--out", tmp_path / "more")
    assert (more.code, more.out.count("(photos: 1, left out: 2, see unplaced.txt there)")) == (0, 2)
    assert [row[0] for row in rows(tmp_path / "more" / "potree" / "coordinates.txt")[1:]] == ["hall.jpg"]
    assert rows(tmp_path / "more" / "tum" / "unplaced.txt") == expected[1:]


def test_a_run_that_was_ended_goes_on_where_it_was_and_does_nothing_twice(
    place: Panoloc, fake: FakeService, out: Path
) -> None:
    fake.answers = {"is rooms/b.png": {}}  # no answer of panoloc: the run ends here
    with pytest.raises(KeyError):
        place("--parallel", "1")
    assert num_queries(fake) == 3
    assert sorted(path.name for path in (out / "results").rglob("*.json")) == ["a.jpg.json", "hall.jpg.json"]
    # As a kill leaves it, while a result is written.
    (out / "results" / "rooms" / ".b.png.json.tmp").write_text('{"na')
    fake.answers, fake.requests = {}, []
    outcome = place()
    assert (outcome.code, num_queries(fake)) == (0, 1)
    assert "already done: 2 of 3 photos" in outcome.err
    assert (place().code, num_queries(fake)) == (0, 1)


def test_a_photo_that_has_changed_is_placed_again(place: Panoloc, fake: FakeService, photos: Path) -> None:
    assert place().code == 0
    with (photos / "hall.jpg").open("ab") as file:
        file.write(b" and more")
    assert (place().code, num_queries(fake)) == (0, 4)


def test_a_busy_service_is_waited_for(place: Panoloc, fake: FakeService, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("panoloc.service.cli.placing.place._RETRY_S", 0.01)
    fake.busy = 2
    outcome = place()
    assert (outcome.code, num_queries(fake)) == (0, 5)
    assert outcome.err.count("waiting for the service") == 1


@pytest.mark.parametrize(
    "refusal",
    [
        problem(404, "There is no such map", "expected the id of a map, got map_9"),
        problem(
            422, "The request cannot be used as it is", "hfov_deg: expected less than map_9", kind="invalid-options"
        ),
    ],
    ids=["of the map", "of the options"],
)
def test_what_says_nothing_of_the_photo_ends_the_run_and_another_may_correct_it(
    place: Panoloc, fake: FakeService, out: Path, refusal: httpx.Response
) -> None:
    fake.fail_with = refusal
    outcome = place("--hfov", "170")
    assert (outcome.code, "map_9" in outcome.err) == (EXIT_ERROR, True)
    assert not list(out.rglob("results/*"))
    fake.fail_with = None
    assert place("--hfov", "90").code == 0


def test_refused_photos_alone_do_not_keep_a_folder_from_other_options(
    place: Panoloc, fake: FakeService, out: Path
) -> None:
    fake.fail_with = problem(422, "The image is damaged", "send it whole")
    assert place("--hfov", "80").code == EXIT_ERROR
    assert list(out.rglob("results/**/*.json"))
    fake.fail_with = None
    assert "different run" not in place("--hfov", "90").err


@pytest.mark.parametrize(("status", "title"), [(504, "No answer before the deadline"), (500, "The service failed")])
def test_a_failure_that_is_not_of_the_photo_is_tried_again_by_the_next_run(
    place: Panoloc, fake: FakeService, out: Path, status: int, title: str
) -> None:
    fake.refuse_file = "is rooms/b.png"
    fake.refusal = problem(status, title, "try again")
    assert (place().code, num_queries(fake)) == (EXIT_ERROR, 3)
    assert "rooms/b.png" in (out / "unplaced.txt").read_text()
    fake.refusal = problem(422, "The image is damaged", "send it whole")
    assert (place().code, num_queries(fake)) == (EXIT_ERROR, 4)
    fake.refuse_file = None
    assert (place().code, num_queries(fake)) == (EXIT_ERROR, 4)


def test_two_runs_do_not_share_a_folder_and_one_that_was_killed_holds_none(
    place: Panoloc, fake: FakeService, photos: Path, out: Path
) -> None:
    with PlaceFolder.held(out, Question(str(photos), ["map_1"], None, {"method": "fast"})):
        outcome = place()
        assert (outcome.code, num_queries(fake)) == (EXIT_USAGE, 0)
        assert "another `panoloc place`" in outcome.said
    assert (out / ".lock").exists()
    assert place().code == 0


def test_an_export_minds_a_georeference_that_came_after_the_photos_were_placed(
    place: Panoloc, panoloc: Panoloc, fake: FakeService, out: Path
) -> None:
    outcome = place("--export", "tum")
    assert outcome.code == 0, outcome.err
    assert (out / "tum" / "poses.tum").exists()
    fake.down = True
    outcome = panoloc("export", out, "--export", "geojson")
    assert (outcome.code, "no service answers" in outcome.err) == (EXIT_ERROR, True)
    assert "`panoloc maps control-points map_1 --apply` sets one" in outcome.said
    assert not (out / "geojson").exists()
    fake.down = False
    fake.polls = [IN_SEATTLE]
    assert panoloc("export", out, "--export", "geojson").code == 0
    assert len(json.loads((out / "geojson" / "photos.geojson").read_text())["features"]) == 3
    fake.down = True
    assert panoloc("export", out, "--export", "stac").code == 0


@pytest.mark.slow
@pytest.mark.usefixtures("pictures")
def test_pictures_show_where_the_photos_stand_and_what_became_of_each(
    place: Panoloc, panoloc: Panoloc, fake: FakeService, photos: Path, out: Path, tmp_path: Path
) -> None:
    fake.answers = {"is hall.jpg": {**answer_with("localized"), "map_id": "map_2"}}
    assert panoloc("place", photos, "--tag", "house", "--out", out, "--export", "tum").code == 0
    assert (out / "map_2" / "tum").is_dir()
    assert sorted(path.name for path in out.glob("*.*g")) == ["contact-sheet.jpg", "plan-map_1.png", "plan-map_2.png"]
    # None of them is taken for a photo, and nothing is drawn in a map where no photo was found.
    fake.answers, fake.answer = {}, answer_with("not_localized")
    again = tmp_path / "again"
    assert place("--out", again).code == EXIT_NOT_LOCALIZED
    assert [path.name for path in again.glob("*.*g")] == ["contact-sheet.jpg"]


def test_the_panoramas_of_a_survey_are_placed_as_a_folder_of_them_is(
    panoloc: Panoloc, fake: FakeService, photos: Path, out: Path, tmp_path: Path
) -> None:
    pytest.importorskip("pye57")
    placed = PlacedPhoto("hall.jpg", Pose(np.eye(3), np.zeros(3)), 64, 32, image=photos / "hall.jpg")
    survey = written("e57", Tour("map_1", (placed,)), tmp_path / "survey") / "tour.e57"
    into = ("--map", "map_1", "--out", out, "--export", "tum")
    assert "1 photo: 1 localized" in panoloc("place", survey, *into).out
    assert (out / "images" / "hall.jpg").read_bytes() == (photos / "hall.jpg").read_bytes()
    assert panoloc("place", survey, *into).code == 0
    assert num_queries(fake) == 1
    (tmp_path / "broken.e57").write_bytes(survey.read_bytes()[:-1000])
    for source, said in ((photos / "notes.txt", "neither"), (tmp_path / "broken.e57", "damaged")):
        outcome = panoloc("place", source, "--map", "map_1", "--out", tmp_path / "more")
        assert (outcome.code, said in outcome.err) == (EXIT_USAGE, True), outcome.err


def test_photos_in_several_maps_are_written_map_by_map(
    panoloc: Panoloc, fake: FakeService, photos: Path, out: Path
) -> None:
    fake.answers = {"is hall.jpg": {**answer_with("localized"), "map_id": "map_2"}}
    assert panoloc("place", photos, "--tag", "house", "--out", out, "--export", "potree").code == 0
    assert [row[0] for row in rows(out / "map_2" / "potree" / "coordinates.txt")[1:]] == ["hall.jpg"]
    assert rows(out / "map_1" / "potree" / "unplaced.txt") == [["hall.jpg", "placed in another map, map_2"]]
    assert panoloc("export", out, "--export", "tum", "--map", "map_2").code == 0
    assert json.loads((out / "tum" / "export.json").read_text())["num_photos"] == 1
    outcome = panoloc("export", out, "--export", "tum", "--map", "map_3")
    assert (outcome.code, "the photos are in map_1, map_2" in outcome.said) == (EXIT_USAGE, True)


def test_an_export_that_fails_leaves_no_half_of_it_and_what_was_there_stays(
    place: Panoloc, panoloc: Panoloc, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert place("--export", "tum").code == 0
    whole = sorted(path.name for path in (out / "tum").iterdir())

    def full(command: list[str], **_: object) -> subprocess.CompletedProcess[str]:
        """Write a part, as until a disk is full."""
        Path(command[-1]).mkdir(exist_ok=True)
        (Path(command[-1]) / "part").write_text("half")
        return subprocess.CompletedProcess(command, 1, "", "OSError: [Errno 28] No space left on device")

    monkeypatch.setattr(subprocess, "run", full)
    outcome = panoloc("export", out, "--export", "tum,potree")
    assert (outcome.code, "No space left" in outcome.said) == (EXIT_ERROR, True)
    assert not (out / "potree").exists()
    assert set(whole) <= {path.name for path in (out / "tum").iterdir()}


def test_json_has_a_line_per_photo_and_one_of_all(place: Panoloc) -> None:
    *each, last = place("--json").documents
    assert sorted(document["photo"] for document in each) == ["hall.jpg", "rooms/a.jpg", "rooms/b.png"]
    assert {document["status"] for document in each} == {"localized"}
    assert (last["num_photos"], last["counts"]) == (3, {"localized": 3})


def test_a_format_of_places_on_earth_is_refused_before_the_first_photo_where_the_map_has_none(
    panoloc: Panoloc, fake: FakeService, photos: Path, out: Path
) -> None:
    command = ("place", photos, "--out", out, "--export", "potree,geojson")
    for choice in (("--map", "map_1"), ("--tag", "building 7")):
        outcome = panoloc(*command, *choice)
        assert outcome.code == EXIT_USAGE
        assert "geojson: expected a map with a georeference" in outcome.said
        assert "panoloc maps set MAP --coordinate-system" in outcome.said
    assert num_queries(fake) == 0
    fake.polls = [IN_SEATTLE] * 2
    assert panoloc(*command, "--map", "map_1").code == 0
    assert (out / "geojson").exists()


def test_why_an_export_uses_stored_data_is_a_note_and_no_further_error(
    place: Panoloc, panoloc: Panoloc, fake: FakeService, out: Path
) -> None:
    assert place().code == 0
    fake.at_maps = {"map_1": problem(404, "There is no such map", "expected the id of a map, got 'map_1'")}
    outcome = panoloc("export", out, "--export", "geojson")
    assert (outcome.code, outcome.err.count("Error:")) == (EXIT_ERROR, 1)
    words = " ".join(outcome.err.split())
    assert (
        "Note: the export uses what is stored from the time of placing; newer data could not be read: expected" in words
    )


def test_wrong_usage_is_told(place: Panoloc, panoloc: Panoloc, fake: FakeService, photos: Path, out: Path) -> None:
    assert panoloc("place", photos, "--out", out).code == EXIT_USAGE
    assert place("--export", "kml").code == EXIT_USAGE
    assert place().code == 0
    outcome = place("--upright")
    assert (outcome.code, "another --out" in outcome.err) == (EXIT_USAGE, True)
    for source, formats in ((photos, "potree"), ("nowhere", "potree"), (out, ",")):
        assert panoloc("export", source, "--export", formats).code == EXIT_USAGE
    outcome = panoloc("export", out, "--export", "e57", "--scan", photos / "notes.txt")
    assert (outcome.code, "expected an E57 file" in outcome.said) == (EXIT_USAGE, True)
    assert num_queries(fake) == 3


def test_a_batch_is_fetched_from_the_service(panoloc: Panoloc, fake: FakeService, tmp_path: Path) -> None:
    outcome = panoloc(
        "export", "batch_1", "--export", "potree,tum", "--map", "map_1", "--include-ambiguous", "--out", tmp_path
    )
    assert outcome.code == 0, outcome.err
    for name in ("potree", "tum"):
        query = (tmp_path / name / "query.txt").read_text()
        assert query == f"format={name}&map_id=map_1&include=ambiguous"
    fake.fail_with = problem(422, "Refused", "set one of them; PATCH /maps/map_1 sets one")
    outcome = panoloc("export", "batch_1", "--export", "geojson", "--out", tmp_path)
    assert (outcome.code, "`panoloc maps control-points map_1 --apply` sets one" in outcome.said) == (EXIT_ERROR, True)
    fake.fail_with = problem(404, "There is no such batch", "unknown")
    assert panoloc("export", "batch_1", "--export", "potree", "--out", tmp_path).code == EXIT_ERROR


def test_what_was_placed_is_kept_once_as_a_batch_under_the_name_of_its_folder(
    place: Panoloc, fake: FakeService, photos: Path
) -> None:
    fake.refuse_file = "is rooms/b.png"
    outcome = place()
    assert "kept as batch batch_1, 'photos' in the console" in outcome.err
    assert fake.batches == [{"name": "photos", "answers": ["loc_1", "loc_1"]}]
    (photos / "attic.jpg").write_bytes((photos / "hall.jpg").read_bytes())
    place("--name", "ground floor")
    assert fake.batches[1:] == [{"name": "ground floor", "answers": ["loc_1"]}]
    place()
    assert len(fake.batches) == 2


def test_a_photo_placed_by_hand_in_the_console_is_placed_in_the_folder_too_until_that_is_taken_back(
    place: Panoloc, panoloc: Panoloc, fake: FakeService, out: Path
) -> None:
    lost, by_hand = answer_with("not_localized"), {**answer_with("localized"), "placed_by": "hand"}
    fake.answers = {"is hall.jpg": lost}

    def placed(answer: dict[str, object]) -> list[str]:
        other = {"name": "rooms/a.jpg", "status": "not_localized", "answer": lost}
        fake.batch_items = [[other], [{"name": "hall.jpg", "status": answer["status"], "answer": answer}]]
        place("--export", "potree")
        return [row[0] for row in rows(out / "potree" / "coordinates.txt")[1:]]

    assert placed(lost) == ["rooms/a.jpg", "rooms/b.png"]
    assert placed(by_hand) == ["hall.jpg", "rooms/a.jpg", "rooms/b.png"]
    assert (out / "unplaced.txt").read_text() == ""
    assert placed(lost) == ["rooms/a.jpg", "rooms/b.png"]
    fake.batch_items = [[{"name": "hall.jpg", "status": "localized", "answer": by_hand}]]
    assert panoloc("export", out, "--export", "potree").code == 0
    assert rows(out / "potree" / "coordinates.txt")[1][0] == "hall.jpg"
    assert (len(fake.batches), num_queries(fake)) == (1, 3)


def test_a_batch_that_was_deleted_does_not_end_the_run(place: Panoloc, fake: FakeService) -> None:
    place()
    gone = problem(404, "There is no such batch", "send the images again")
    fake.on_request = lambda request: gone if request.url.path == "/batches/batch_1" else None
    assert place().code == 0


def test_a_key_that_may_not_read_batches_places_all_the_same(place: Panoloc, fake: FakeService) -> None:
    place()
    refused = problem(403, "The key does not allow this", "expected a key with the scope 'localize'")
    fake.on_request = lambda request: refused if request.url.path == "/batches/batch_1" else None
    outcome = place()
    assert (outcome.code, "already done: 3 of 3 photos" in outcome.err) == (0, True)
    assert "photos placed by hand since are not taken over: expected a key with the scope 'localize'" in outcome.said


def test_a_batch_that_is_refused_does_not_fail_the_run_and_is_made_by_the_next(
    place: Panoloc, fake: FakeService
) -> None:
    fake.batch_refusal = problem(409, "There are too many batches", "delete a batch that is no longer needed")
    outcome = place()
    assert (outcome.code, "not kept as a batch" in outcome.err) == (0, True)
    fake.batch_refusal = None
    assert "kept as batch" in place().err
    assert num_queries(fake) == 3


def test_where_one_of_several_batches_is_refused_those_before_it_are_named(
    place: Panoloc, fake: FakeService, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("panoloc.service.cli.placing.place.IMAGES_AT_A_TIME", 2)
    refused = problem(409, "There are too many batches", "delete a batch that is no longer needed")
    fake.on_request = lambda request: refused if request.url.path == "/batches" and fake.batches else None
    said = place().said
    assert "kept as batch batch_1" in said
    assert "not kept as a batch: 1 of 3 photos" in said


def test_exports_are_never_taken_for_photos(place: Panoloc, fake: FakeService, photos: Path) -> None:
    into = place("--out", photos)
    assert (into.code, "than the folder of the photos" in into.said, num_queries(fake)) == (EXIT_USAGE, True, 0)
    for name in ("placed", "again"):
        assert "3 photos: 3 localized" in place("--export", "navvis", "--out", photos / name).out
    assert num_queries(fake) == 6
