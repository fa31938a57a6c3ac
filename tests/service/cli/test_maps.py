"""`panoloc maps` against a fake service."""

import json
from pathlib import Path
from typing import Any

import httpx
import pytest

from panoloc.service.cli.exit_codes import ExitCode
from panoloc.service.http.schemas.control import CONTROL_EXAMPLE
from tests.service.cli.commands import Panoloc
from tests.service.cli.fake_service import READY_MAP, FakeService, problem


def test_maps_of_all_pages_are_listed(panoloc: Panoloc, fake: FakeService) -> None:
    fake.places = [READY_MAP, {**READY_MAP, "id": "map_2", "status": "indexing", "progress": 0.4, "stats": None}]
    out = panoloc("maps").out
    assert "map_1" in out
    assert "412" in out
    assert "1.8 MB" in out
    assert "map_2" in out
    assert "indexing 40%" in out


STEERING = "\x1b]0;owned\x07 \x9b31m \x08\x7f\u202e"


def test_names_and_messages_do_not_steer_the_terminal(panoloc: Panoloc, fake: FakeService) -> None:
    error = {"detail": f"scan: got {STEERING}"}
    fake.places = [{**READY_MAP, "name": f"a{STEERING}b", "tags": [STEERING], "status": "failed", "error": error}]
    done = panoloc("maps")
    assert "owned" in done.out
    assert not set(STEERING) & set(done.out) - set(" ]0;owned31m")


def test_json_output_is_one_map_per_line(panoloc: Panoloc, fake: FakeService) -> None:
    fake.places = [READY_MAP, {**READY_MAP, "id": "map_2"}]
    assert [place["id"] for place in panoloc("maps", "--json").documents] == ["map_1", "map_2"]


@pytest.mark.parametrize("command", [("maps",), ("maps", "list")])
def test_a_tag_narrows_the_list(panoloc: Panoloc, fake: FakeService, command: tuple[str, ...]) -> None:
    panoloc(*command, "--tag", "floor 3")
    assert fake.requests[0][1] in ("/maps?tag=floor+3", "/maps?tag=floor%203")


def test_an_empty_list_says_how_to_begin(panoloc: Panoloc, fake: FakeService) -> None:
    fake.places = []
    done = panoloc("maps")
    assert done.code == 0
    assert "panoloc register SCAN" in done.err
    assert done.out == ""


def test_a_tag_that_no_map_bears_is_no_reason_to_register_one(panoloc: Panoloc, fake: FakeService) -> None:
    fake.places = []
    done = panoloc("maps", "--tag", "[bold]zzz")
    assert (done.code, done.out, done.err) == (0, "", "No map has the tag [bold]zzz.\n")
    assert panoloc("maps", "--tag", "zzz", "--json").err == ""


UNKNOWN = problem(404, "Unknown map", "There is no map of that id.")
NOBODY = httpx.ConnectError("Connection refused")


@pytest.mark.parametrize(
    ("command", "options", "method", "done_to"),
    [("delete", (), "DELETE", "deleted {}"), ("share", ("--with", "*"), "PATCH", "{} is shared")],
)
def test_a_map_that_is_refused_does_not_keep_the_others(
    panoloc: Panoloc, fake: FakeService, command: str, options: tuple[str, ...], method: str, done_to: str
) -> None:
    fake.at_maps = {
        "map_2": UNKNOWN,
        "map_4": problem(403, "Not yours", "It belongs to another tenant."),
    }
    done = panoloc("maps", command, *(f"map_{number}" for number in range(1, 6)), *options)
    assert done.code == ExitCode.ERROR
    assert fake.requests == [(method, f"/maps/map_{number}") for number in range(1, 6)]
    assert [done_to.format(f"map_{number}") in done.out for number in range(1, 6)] == [True, False, True, False, True]
    told = [line for line in done.err.splitlines() if not line.startswith("request")]
    assert told == [
        "map_2  Unknown map (HTTP 404)",
        "There is no map of that id.",
        "map_4  Not yours (HTTP 403)",
        "It belongs to another tenant.",
    ]


def test_every_map_that_is_not_deleted_has_a_document_of_its_own(panoloc: Panoloc, fake: FakeService) -> None:
    fake.at_maps = {"map_1": UNKNOWN}
    deleted, failed = panoloc("maps", "delete", "map_1", "map_2", "--json").documents
    assert deleted == {"id": "map_2", "deleted": True}
    assert (failed["id"], failed["error"]["status"]) == ("map_1", 404)


def test_where_nobody_answers_any_more_the_rest_is_named_and_not_tried(panoloc: Panoloc, fake: FakeService) -> None:
    fake.at_maps = {"map_2": NOBODY}
    done = panoloc("maps", "delete", "map_1", "map_2", "map_3")
    assert done.code == ExitCode.UNREACHABLE
    assert fake.requests == [("DELETE", "/maps/map_1"), ("DELETE", "/maps/map_2")]
    assert done.out == "deleted map_1\n"
    assert "map_2, map_3  Error: No service answers" in done.err
    assert done.err.count("panoloc serve") == 1


def test_the_exit_code_is_that_of_the_first_failure(panoloc: Panoloc, fake: FakeService) -> None:
    fake.at_maps = {"map_1": UNKNOWN, "map_2": NOBODY}
    done = panoloc("maps", "delete", "map_1", "map_2")
    assert done.code == ExitCode.ERROR
    assert "map_2  Error: No service answers" in done.err


def test_a_key_that_is_none_is_not_tried_for_every_map(panoloc: Panoloc, fake: FakeService) -> None:
    fake.fail_with = problem(401, "An API key is needed", "expected an API key, got none")
    done = panoloc("maps", "delete", "map_1", "map_2", "--json")
    assert done.code == ExitCode.ERROR
    assert len(fake.requests) == 1
    assert [document["id"] for document in done.documents] == ["map_1", "map_2"]
    assert done.err.count("Set PANOLOC_API_KEY") == 1


def test_maps_are_shared_with_those_that_are_named_and_no_others(panoloc: Panoloc, fake: FakeService) -> None:
    done = panoloc("maps", "share", "map_1", "map_2", "map_1", "--with", "museum", "--with", "*")
    assert done.code == 0, done.err
    assert fake.requests == [("PATCH", "/maps/map_1"), ("PATCH", "/maps/map_2")]
    assert done.out.splitlines() == [f"map_{number} is shared with museum, *" for number in (1, 2)]
    assert "map_1 is shared with nobody" in panoloc("maps", "share", "map_1", "--with", "").out
    (shown,) = panoloc("maps", "share", "map_1", "--with", "school", "--json").documents
    assert shown["shared_with"] == ["school"]


def test_who_does_not_say_with_whom_takes_a_map_from_nobody(panoloc: Panoloc, fake: FakeService) -> None:
    done = panoloc("maps", "share", "map_1")
    assert (done.code, fake.requests) == (ExitCode.USAGE, [])
    assert "make a code for phones" in done.err


def test_nothing_is_not_changed(panoloc: Panoloc, fake: FakeService) -> None:
    outcome = panoloc("maps", "set", "map_1")
    assert (outcome.code, "give at least one of --name, --unit" in outcome.said) == (ExitCode.USAGE, True)
    assert fake.requests == []


@pytest.mark.parametrize(
    ("url", "note"),
    [
        ("https://scanner.local:8000", None),
        ("http://scanner.local:8000", "https:// alone"),
        ("http://127.0.0.1:8000", "with --at"),
    ],
)
def test_a_link_for_phones_is_printed_with_its_code(
    panoloc: Panoloc, fake: FakeService, url: str, note: str | None
) -> None:
    done = panoloc("maps", "share", "map_1", "--qr", "--at", url)
    link = f"{url}/m/map_1#key=pk_1"
    assert (done.code, done.out.splitlines()[0]) == (0, link)
    assert "\u2580" in done.out
    assert "panoloc keys revoke key_1" in done.err
    assert [each in done.err for each in ("https:// alone", "with --at")] == [
        each == note for each in ("https:// alone", "with --at")
    ]
    assert [request[0] for request in fake.requests] == ["POST"]
    assert panoloc("maps", "share", "map_1", "--qr", "--at", url, "--json").documents == [
        {"id": "map_1", "url": link, "key_id": "key_1"}
    ]


def test_an_address_for_phones_without_its_scheme_is_asked_for_it(panoloc: Panoloc, fake: FakeService) -> None:
    done = panoloc("maps", "share", "map_1", "--qr", "--at", "127.0.0.1:18432")
    assert (done.code, fake.requests) == (ExitCode.USAGE, [])
    assert "--at" in done.said
    assert "http:// or https://" in done.said


def test_tenants_change_only_where_they_are_named(panoloc: Panoloc, fake: FakeService) -> None:
    panoloc("maps", "share", "map_1", "--qr", "--with", "museum")
    assert [request[0] for request in fake.requests] == ["PATCH", "POST"]
    fake.requests.clear()
    fake.at_maps = {"map_1": UNKNOWN}
    assert panoloc("maps", "share", "map_1", "--qr", "--with", "museum").code == ExitCode.ERROR
    assert [request[0] for request in fake.requests] == ["PATCH"]


ERROR = {"detail": "scan: expected 100 vertices, got 40"}


@pytest.mark.parametrize(
    ("place", "shown"),
    [
        ({"status": "ready"}, ["ready"]),
        ({"status": "queued", "serving_revision": None}, ["queued"]),
        (
            {"status": "failed", "serving_revision": None, "error": ERROR},
            ["failed", f"map_1 failed: {ERROR['detail']}"],
        ),
        (
            {"revision": 2, "status": "failed", "error": ERROR},
            [
                "revision 2 failed; 1 still answers",
                f"map_1: revision 1 still answers, revision 2 failed: {ERROR['detail']}",
            ],
        ),
        ({"revision": 3, "status": "indexing", "progress": 0.4}, ["revision 3 indexing 40%; 1 still answers"]),
        ({"revision": 3, "status": "queued", "progress": 0.0}, ["revision 3 queued; 1 still answers"]),
    ],
)
def test_the_state_of_the_newest_revision_is_shown_and_which_older_one_still_answers(
    panoloc: Panoloc, fake: FakeService, place: dict[str, object], shown: list[str]
) -> None:
    fake.places = [READY_MAP | place]
    done = panoloc("maps")
    _, row, *below = done.out.splitlines()
    assert shown[0] in row
    assert below == shown[1:]
    assert ("panoloc maps delete map_1" in done.err) == (shown[0] == "failed")
    assert ("revision" in row) == ("revision" in shown[0])


def test_control_points_are_sent_shown_in_millimetres_and_applied(
    panoloc: Panoloc, fake: FakeService, tmp_path: Path
) -> None:
    points = tmp_path / "points.csv"
    points.write_text("name,x,y,z\nP1,1,2,3\n")
    sent = list[dict[str, Any]]()

    def answer(request: httpx.Request) -> httpx.Response | None:
        sent.append(json.loads(request.content or b"null"))
        return None if request.method == "PATCH" else httpx.Response(200, json=CONTROL_EXAMPLE)

    fake.on_request = answer
    command = ("maps", "control-points", "map_1", str(points), "--system", "EPSG:25832", "--apply")
    out = panoloc(*command, "--geoid-undulation", "46.2").out
    assert sent[0]["csv"] == points.read_text()
    assert sent[0]["coordinate_system"] == "EPSG:25832"
    assert sent[1]["georeference"]["latitude_deg"] == 48.1371
    assert sent[1]["geoid_undulation_m"] == 46.2
    assert "the map has it now" in " ".join(out.split())
    assert "--apply sets it" in " ".join(panoloc("maps", "control-points", "map_1").out.split())
    assert "7.8" in out
    assert "horizontal 8.0, up 4.0, 3D 8.9 mm" in out
    assert "+200 ppm" in out


def test_a_place_by_points_of_which_one_is_wrong_is_not_applied(panoloc: Panoloc, fake: FakeService) -> None:
    report = {**CONTROL_EXAMPLE, "suspect": "P1", "warnings": ["P1 is 0.31 m from where the other points put it"]}
    fake.on_request = lambda request: httpx.Response(200, json=report)
    done = panoloc("maps", "control-points", "map_1", "--apply")
    assert (done.code, [method for method, _ in fake.requests]) == (ExitCode.ERROR, ["GET"])
    assert "The map is as it was: P1 is wrong" in done.err
    assert panoloc("maps", "control-points", "map_1").code == ExitCode.ERROR
    assert "mend or remove P1 first" in " ".join(done.out.split())


def test_a_picture_is_no_table_of_points(panoloc: Panoloc, fake: FakeService, tmp_path: Path) -> None:
    picture = tmp_path / "points.jpg"
    picture.write_bytes(b"\xff\xd8\xff\xe0\0\x10JFIF")
    done = panoloc("maps", "control-points", "map_1", picture)
    assert (done.code, "expected a table of text" in done.said, fake.requests) == (ExitCode.USAGE, True, [])


@pytest.mark.parametrize(("system", "code"), [("EPSG:25832", ExitCode.OK), (None, ExitCode.ERROR)])
def test_a_map_in_a_grid_has_its_place_and_nothing_is_applied(
    panoloc: Panoloc, fake: FakeService, system: str | None, code: int
) -> None:
    why = "the map's positions are coordinates of a grid already, so there is nothing to apply"
    fit = CONTROL_EXAMPLE["fit"] | {"georeference": None}
    report = {**CONTROL_EXAMPLE, "as_is": fit, "fit": fit, "no_georeference": why}
    place = READY_MAP | {"coordinate_system": system}
    fake.on_request = lambda request: httpx.Response(200, json=report if "control" in request.url.path else place)
    done = panoloc("maps", "control-points", "map_1", "--apply")
    assert (done.code, {method for method, _ in fake.requests}) == (code, {"GET"})
    assert "nothing to apply" in " ".join(done.err.split())


def test_points_that_give_no_place_leave_the_map_as_it_is(panoloc: Panoloc, fake: FakeService) -> None:
    why = "points: expected 3 or more points with a place in the scan, got 1; click more of them in the scan"
    report = {**CONTROL_EXAMPLE, "fit": None, "no_fit": why, "no_georeference": why}
    fake.on_request = lambda request: httpx.Response(200, json=report)
    done = panoloc("maps", "control-points", "map_1", "--apply")
    assert done.code == ExitCode.ERROR
    assert [method for method, _ in fake.requests] == ["GET"]
    assert "The map is as it was" in done.err
    assert "click more" in " ".join(done.out.split())
