"""`panoloc localize` against a fake service."""

import json
from pathlib import Path

import httpx
import pytest

from panoloc.core.options import MAX_TOP_K
from panoloc.service.client import JsonClient
from panoloc.service.http.schemas.queries import LocalizeOptions
from tests.service.cli.commands import Panoloc
from tests.service.cli.fake_service import FakeService, answer_with


@pytest.fixture
def localize(panoloc: Panoloc, panorama: Path) -> Panoloc:
    """Return a function that localizes a panorama in map_1."""
    return lambda *options: panoloc("localize", panorama, "--map", "map_1", *options)


@pytest.mark.parametrize(("status", "code"), [("localized", 0), ("not_localized", 3), ("ambiguous", 4)])
def test_the_exit_code_says_whether_a_pose_was_found(
    localize: Panoloc, fake: FakeService, status: str, code: int
) -> None:
    fake.status = status
    done = localize()
    assert done.code == code, done.err
    assert status.replace("_", " ") in done.out


def test_the_table_shows_pose_confidence_and_accuracy(localize: Panoloc) -> None:
    out = localize().out
    for shown in ("x 1.250   y 0.500   z 1.500 m", "yaw 0.00", "0.93", "0.020 m, 0.30 deg (68% radius)", "18%"):
        assert shown in out


def test_an_ambiguous_answer_shows_every_place_that_fits(localize: Panoloc, fake: FakeService) -> None:
    answer = answer_with("ambiguous")
    elsewhere = answer_with("localized")["pose"]
    elsewhere["map_from_camera"]["position_m"] = {"x": -7.0, "y": 8.25, "z": 1.5}
    elsewhere["yaw_deg"] = -167.5
    answer["alternatives"] = [
        {"pose": elsewhere, "confidence": 0.41, "map_id": "map_2"},
        {"pose": answer["pose"], "confidence": 0.07, "map_id": "map_1"},
    ]
    fake.answer = answer
    lines = localize("--map", "map_2").out.splitlines()
    (header,) = [number for number, line in enumerate(lines) if line.startswith("alternative")]
    first, second = lines[header + 1 : header + 3]
    for shown in ("1 ", "x -7.000   y 8.250   z 1.500 m", "yaw -167.50", "0.41", "map_2"):
        assert shown in first
    assert "0.07" in second


def test_links_to_pictures_are_full_addresses_and_stay_whole_in_a_pipe(localize: Panoloc) -> None:
    lines = localize().out.splitlines()
    assert "http://127.0.0.1:8000/localizations/loc_1/score-map-2d.png" in lines


@pytest.mark.parametrize(
    "part",
    [
        {"map_id": None},
        {"accuracy": None},
        {"accuracy": {"position_m": None, "orientation_deg": None, "level": 0.68}},
        {"change": {"panorama_changed_fraction": None, "map_changed_fraction": None}},
        {"artifacts": {}},
    ],
)
def test_an_answer_without_an_optional_part_is_still_shown(
    localize: Panoloc, fake: FakeService, part: dict[str, object]
) -> None:
    fake.answer = answer_with("localized") | part
    done = localize()
    assert done.code == 0, done.err
    assert "x 1.250" in done.out


def test_several_maps_and_all_options_reach_the_service(
    panoloc: Panoloc, fake: FakeService, panorama: Path, tmp_path: Path
) -> None:
    mask = tmp_path / "mask.png"
    mask.write_bytes(b"a mask")
    hints = ["--position", 1, 2, -3.5, "--radius", 5, "--region", 0, 0, 0, 9, 8, 7, "--upright", "--max-tilt", 15]
    done = panoloc(
        *("localize", panorama, "--map", "map_1", "--map", "map_2", "--mask", mask, "--frame", "unity"),
        *("--method", "paper", "--timeout", 12, "--heading", -90, "--heading-tolerance", 45, "--top-k", 3, *hints),
    )
    assert done.code == 0, done.err
    assert fake.parts["map_id"] == [b"map_1", b"map_2"]
    assert fake.parts["image"] == [panorama.read_bytes()]
    assert fake.parts["mask"] == [b"a mask"]
    assert json.loads(fake.parts["options"][0]) == {
        "frame": "unity",
        "method": "paper",
        "top_k": 3,
        "artifacts": [],
        "timeout_s": 12,
        "hints": {
            "position_m": [1, 2, -3.5],
            "radius_m": 5,
            "region": {"min": [0, 0, 0], "max": [9, 8, 7]},
            "upright": True,
            "max_tilt_deg": 15,
            "heading_deg": -90,
            "heading_tolerance_deg": 45,
        },
    }


@pytest.mark.parametrize(("top_k", "code"), [(MAX_TOP_K, 0), (MAX_TOP_K + 1, 2)])
def test_the_command_asks_for_no_more_poses_than_the_service_gives(
    localize: Panoloc, fake: FakeService, top_k: int, code: int
) -> None:
    assert localize("--top-k", top_k).code == code
    for sent in fake.parts.get("options", []):
        LocalizeOptions.model_validate_json(sent)
    assert LocalizeOptions.model_json_schema()["properties"]["top_k"]["maximum"] == MAX_TOP_K


@pytest.mark.parametrize(
    ("arguments", "timeout_s", "read_s"),
    [([], None, None), (["--method", "paper"], None, None), (["--method", "paper", "--timeout", 12], 12, 42)],
)
def test_the_service_says_how_long_a_query_may_take_unless_the_user_does_and_is_waited_for(
    localize: Panoloc,
    fake: FakeService,
    arguments: list[object],
    timeout_s: float | None,
    read_s: float | None,
) -> None:
    waited: list[float | None] = []
    fake.on_request = lambda request: waited.append(request.extensions["timeout"]["read"])
    assert localize(*arguments).code == 0
    assert json.loads(fake.parts["options"][0]).get("timeout_s") == timeout_s
    assert waited == [read_s]


def test_a_tag_stands_for_all_its_maps(panoloc: Panoloc, fake: FakeService, panorama: Path) -> None:
    assert panoloc("localize", panorama, "--tag", "floor 3").code == 0
    assert fake.parts["tag"] == [b"floor 3"]
    assert "map_id" not in fake.parts


@pytest.mark.parametrize(
    ("option", "value", "camera"),
    [
        ("--hfov", "69", {"model": "pinhole", "hfov_deg": 69.0, "unless_panorama": True}),
        ("--hfov", "45-90", {"model": "pinhole", "hfov_range_deg": [45.0, 90.0], "unless_panorama": True}),
        ("--camera", "camera.json", {"model": "pinhole", "hfov_deg": 69.0}),
    ],
)
def test_a_photos_camera_is_sent_along(
    localize: Panoloc, fake: FakeService, panorama: Path, option: str, value: str, camera: dict[str, object]
) -> None:
    (panorama.parent / "camera.json").write_text('{"model": "pinhole", "hfov_deg": 69.0}')
    given = panorama.parent / value if option == "--camera" else value
    assert localize(option, given).code == 0
    assert json.loads(fake.parts["options"][0])["cameras"] == [camera]


def test_that_a_field_of_view_was_not_used_for_a_panorama_is_said(localize: Panoloc, fake: FakeService) -> None:
    words = "taken for a panorama, without --hfov"
    assert words in localize("--hfov", "69").said
    assert words not in localize().said
    fake.answer = answer_with("localized")
    fake.answer["images"][0]["camera"] = {"model": "pinhole", "hfov_deg": 69.0}
    assert words not in localize("--hfov", "69").said


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--radius", "5"], "--radius needs --position"),
        (["--heading-tolerance", "5"], "--heading-tolerance needs --heading"),
        (["--camera", "text.json"], "expected a JSON file"),
        (["--camera", "list.json"], "expected an object such as"),
        (["--camera", "text.json", "--hfov", "69"], "expected either --hfov or --camera"),
        (["--tag", "x"], "expected --map ID (repeatable) or --tag TAG, got both"),
        (["--hfov=45-"], "expected degrees such as 69"),
        (["--hfov=wide"], "expected degrees such as 69"),
        (["--hfov=90-45"], "two rising numbers"),
        *(([f"--hfov={degrees}"], "expected 1 to 170 degrees") for degrees in ("-5", "400", "nan")),
    ],
)
def test_options_that_mean_nothing_are_wrong_usage(
    localize: Panoloc,
    fake: FakeService,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    arguments: list[str],
    said: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("text.json").write_text("no JSON")
    Path("list.json").write_text("[1]")
    done = localize(*arguments)
    assert (done.code, fake.requests) == (2, [])
    assert said in done.said


def test_a_folder_that_cannot_be_written_is_named_before_anything_is_sent(
    localize: Panoloc, panoloc: Panoloc, fake: FakeService, panorama: Path
) -> None:
    out = panorama / "answers"
    done = localize("--out", out)
    assert (done.code, fake.requests) == (1, [])
    assert f"--out {out}: expected a folder that can be written, got: Not a directory" in done.said
    assert panoloc("export", "batch_1", "--export", "tum", "--out", out).code == 1
    assert fake.requests == []


def test_a_folder_receives_the_answer_and_its_pictures(localize: Panoloc, fake: FakeService, tmp_path: Path) -> None:
    out = tmp_path / "new" / "answers"
    assert localize("--out", out).code == 0
    assert json.loads(fake.parts["options"][0])["artifacts"] == ["score_map_2d", "score_map_3d", "overlay"]
    assert json.loads((out / "photo.json").read_text())["id"] == "loc_1"
    assert (out / "photo.score-map-2d.png").read_bytes() == b"a picture"


def test_panoramas_of_the_same_name_do_not_overwrite_each_other(
    panoloc: Panoloc, panorama: Path, tmp_path: Path
) -> None:
    other = tmp_path / "other" / panorama.name
    other.parent.mkdir()
    other.write_bytes(b"another")
    into = "--map", "map_1", "--out", tmp_path / "out"
    panoloc("localize", panorama, other, *into)
    assert {path.name for path in (tmp_path / "out").glob("*.json")} == {"photo.json", "photo-2.json"}
    # Nor do those of another command; the same photo has one answer.
    third = tmp_path / "third" / panorama.name
    third.parent.mkdir()
    third.write_bytes(b"a third")
    for again in (third, third, panorama):
        panoloc("localize", again, *into)
    files = {path.name: json.loads(path.read_text())["files"] for path in (tmp_path / "out").glob("*.json")}
    assert files == {"photo.json": [str(panorama)], "photo-2.json": [str(other)], "photo-3.json": [str(third)]}


def test_one_refused_panorama_does_not_stop_the_others(
    panoloc: Panoloc, fake: FakeService, panorama: Path, tmp_path: Path
) -> None:
    wrong = tmp_path / "wrong.jpg"
    wrong.write_bytes(b"not a panorama")
    fake.refuse_file = "not a panorama"
    done = panoloc("localize", wrong, panorama, "--map", "map_1", "--json")
    assert done.code == 1
    assert [document["panorama"] for document in done.documents] == [str(wrong), str(panorama)]
    assert done.documents[0]["error"]["status"] == 422
    assert done.documents[1]["status"] == "localized"
    assert "expected 2:1, got 3000 x 2000" in done.err


@pytest.mark.parametrize(
    ("status", "hfov_deg", "shown"),
    [
        ("localized", 69.0, ["18% of what the photo shows"]),
        ("localized", 360.0, ["18% of the panorama"]),
        ("not_localized", 360.0, []),
    ],
)
def test_what_changed_is_a_share_of_what_the_image_shows_and_said_only_beside_a_pose(
    localize: Panoloc, fake: FakeService, status: str, hfov_deg: float, shown: list[str]
) -> None:
    fake.answer = answer_with(status)
    fake.answer["images"][0]["camera"]["hfov_deg"] = hfov_deg
    out = localize().out
    assert [line.partition("changed")[2].strip() for line in out.splitlines() if "18%" in line] == shown


def test_a_program_sends_several_images_with_a_mask_for_each(fake: FakeService, tmp_path: Path) -> None:
    images = [tmp_path / "0.jpg", tmp_path / "1.png"]
    masks = [tmp_path / "mask-0.png", tmp_path / "mask-1.png"]
    for path in (*images, *masks):
        path.write_bytes(path.name.encode())
    with JsonClient("http://127.0.0.1:8000", transport=httpx.MockTransport(fake.handle)) as client:
        answer = client.localize(images, ["map_1"], mask=masks, options={"frame": "webxr"})
    assert answer["status"] == "localized"
    assert fake.parts["image"] == [b"0.jpg", b"1.png"]
    assert fake.parts["mask"] == [b"mask-0.png", b"mask-1.png"]
