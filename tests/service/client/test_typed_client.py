"""`PanolocClient`: what the service sends, as models whose type depends on the status; and the page that shows it, by mypy."""

import copy
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import httpx
import pytest

from panoloc import Ambiguous, Localized, Map, NotLocalized, PanolocClient
from panoloc.service.client import ApiProblemError, ClientError, MapFailedError, UnexpectedReplyError, UnreachableError
from panoloc.service.http.schemas.examples import LOCALIZATION_EXAMPLE, MAP_EXAMPLE
from panoloc.service.http.schemas.queries import LocalizeOptions
from tests.service.light_modules import core_modules

ROOT = Path(__file__).resolve().parents[3]
WITHOUT_POSE = dict.fromkeys(("map_id", "map_revision", "pose", "map_from_session", "geopose", "accuracy"))


def client_of(document: dict[str, Any], sent: list[bytes] | None = None, status: int = 200) -> PanolocClient:
    """Return a client of a service that answers everything alike. sent: the body of each request is added to it."""

    def answer(request: httpx.Request) -> httpx.Response:
        if sent is not None:
            sent.append(request.read())
        return httpx.Response(status, json=document)

    return PanolocClient("http://127.0.0.1:8000", transport=httpx.MockTransport(answer))


@pytest.fixture
def photo(tmp_path: Path) -> Path:
    (tmp_path / "photo.jpg").write_bytes(b"\xff\xd8\xff")
    return tmp_path / "photo.jpg"


def test_an_answer_is_what_its_status_says(photo: Path) -> None:
    for changes, model in (
        ({}, Localized),
        ({"status": "ambiguous"}, Ambiguous),
        ({"status": "not_localized", **WITHOUT_POSE}, NotLocalized),
    ):
        document = {**LOCALIZATION_EXAMPLE, **changes}
        with client_of(document) as client:
            answer = client.localize(photo, ["map_1"])
        assert type(answer) is model
        assert answer.model_dump(mode="json", exclude_unset=True) == document
        if answer.status == "localized":
            assert answer.pose.map_from_camera.position_m.x == document["pose"]["map_from_camera"]["position_m"]["x"]


def test_maps_are_models_too_and_keep_fields_of_newer_services() -> None:
    with client_of({**MAP_EXAMPLE, "floor": 3}) as client:
        place = client.get_map("map_1")
        heard: list[Map] = []
        assert client.wait_for_map("map_1", heard.append) == place == heard[0]
    assert isinstance(place, Map)
    assert (place.status, place.model_dump()["floor"]) == ("ready", 3)
    with client_of({"items": [MAP_EXAMPLE], "next_cursor": None}) as client:
        assert [each.id for each in client.list_maps()] == [MAP_EXAMPLE["id"]]
    flat: dict[str, Any] = copy.deepcopy(MAP_EXAMPLE)
    flat["stats"]["bounds"] = {"min": [0, 0, 1], "max": [4, 3, 1]}
    with client_of(flat) as client:
        stats = client.get_map("map_1").stats
    assert stats is not None
    assert stats.bounds.max == [4, 3, 1]
    failed = {**MAP_EXAMPLE, "status": "failed", "error": {"detail": "too few points"}}
    with client_of(failed) as client, pytest.raises(MapFailedError, match="too few points"):
        client.wait_for_map("map_1")


def test_a_reply_of_another_version_says_where_it_differs(photo: Path) -> None:
    strange = {**LOCALIZATION_EXAMPLE, "confidence": "high"}
    with client_of(strange) as client, pytest.raises(UnexpectedReplyError, match=r"confidence: .*install the version"):
        client.localize(photo, ["map_1"])
    with client_of({"status": "lost"}) as client, pytest.raises(UnexpectedReplyError, match="localized"):
        client.localize(photo, ["map_1"])


def test_the_pose_of_an_answer_is_a_prior_as_it_is(photo: Path) -> None:
    sent = list[bytes]()
    with client_of(LOCALIZATION_EXAMPLE, sent) as client:
        last = client.localize(photo, ["map_1"])
        assert last.status == "localized"
        prior = {"pose": last.pose, "position_std_m": 0.5}
        client.localize(photo, ["map_1"], options={"hints": {"prior": prior}})
        with pytest.raises(TypeError, match=r"options: expected JSON .* got a set"):
            client.localize(photo, ["map_1"], options={"hints": {1, 2}})
    (text,) = re.findall(rb'name="options"\r\n\r\n(.*)\r\n', sent[1])
    hinted = LocalizeOptions.model_validate_json(text).hints
    assert hinted is not None
    assert hinted.prior is not None
    assert hinted.prior.pose is not None
    position = hinted.prior.pose.map_from_camera.position_m
    assert position.model_dump() == LOCALIZATION_EXAMPLE["pose"]["map_from_camera"]["position_m"]


def test_what_an_answer_links_to_is_written_into_a_new_file(tmp_path: Path) -> None:
    with client_of({"a": 1}) as client:
        client.download("/artifacts/1", {}, tmp_path / "new.json")
    assert (tmp_path / "new.json").read_text() == '{"a":1}'
    with client_of({"detail": "expired"}, status=404) as client, pytest.raises(ApiProblemError):
        client.download("/artifacts/1", {}, tmp_path / "new.json")
    assert (tmp_path / "new.json").read_text() == '{"a":1}', "what is refused replaces nothing"


def test_a_text_is_a_path_and_one_id_is_a_list_of_it(photo: Path) -> None:
    sent = list[bytes]()
    with client_of(LOCALIZATION_EXAMPLE, sent) as client:
        client.localize(str(photo), "map_1", mask=[str(photo)])
    assert re.findall(rb'name="map_id"\r\n\r\n(.*)\r\n', sent[0]) == [b"map_1"]
    assert re.findall(rb'name="(image|mask)"; filename="photo.jpg"', sent[0]) == [b"image", b"mask"]


def test_no_image_and_a_file_that_is_not_there_are_said_before_anything_is_sent(tmp_path: Path) -> None:
    with client_of(LOCALIZATION_EXAMPLE) as client:
        with pytest.raises(ClientError, match="expected an image, got none"):
            client.localize([], ["map_1"])
        with pytest.raises(FileNotFoundError):
            client.localize(tmp_path / "nope.jpg", ["map_1"])
        with pytest.raises(IsADirectoryError):
            client.register_map(tmp_path)


@pytest.mark.parametrize("said", ["[SSL: WRONG_VERSION_NUMBER] wrong version number", "[SSL] record layer failure"])
def test_a_service_without_https_is_said_to_have_none(said: str) -> None:
    def fail(request: httpx.Request) -> httpx.Response:
        raise httpx.ConnectError(said)

    with (
        PanolocClient("https://127.0.0.1:8000", transport=httpx.MockTransport(fail)) as client,
        pytest.raises(UnreachableError, match="speaks http there, not https; use http://"),
    ):
        client.get_map("map_1")


def test_an_id_is_no_path() -> None:
    asked = list[bytes]()

    def answer(request: httpx.Request) -> httpx.Response:
        asked.append(request.url.raw_path)
        return httpx.Response(200, json=MAP_EXAMPLE)

    with PanolocClient("http://127.0.0.1:8000", transport=httpx.MockTransport(answer)) as client:
        client.get_map("../health")
        client.delete_map("a/b?c")
    assert asked == [b"/maps/..%2Fhealth", b"/maps/a%2Fb%3Fc"]


def test_the_client_loads_neither_torch_nor_numpy_nor_the_server() -> None:
    program = "import sys; from panoloc import PanolocClient; print(*sys.modules)"
    said = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout.split()
    assert not {"torch", "numpy", "PIL", "fastapi", "starlette", "redis", "pyproj"} & set(said)
    assert "panoloc.core.localizer" not in core_modules(set(said))


@pytest.mark.slow
def test_the_code_of_the_page_passes_mypy_and_a_pose_without_a_look_at_the_status_does_not(tmp_path: Path) -> None:
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "python.md").read_text(encoding="utf-8"), re.S)
    page = tmp_path / "page.py"
    page.write_text("\n".join(blocks), encoding="utf-8")
    wrong = tmp_path / "wrong.py"
    wrong.write_text("\n".join([*blocks, "answer.pose.frame", "answer.position", "place['id']"]), encoding="utf-8")
    said = checked(page, wrong)
    assert [re.sub(r"^.*\[|\]$", "", line) for line in said] == ["union-attr"] * 4 + ["index"], said
    # Of a file that it knows, mypy tells the folder of an earlier run.
    assert {Path(line.partition(":")[0]).name for line in said} == {wrong.name}


def checked(*files: Path) -> list[str]:
    """Return the errors that mypy finds."""
    config = ["--strict", "--config-file", str(ROOT / "pyproject.toml"), "--cache-dir", str(ROOT / ".mypy_cache")]
    command = [sys.executable, "-m", "mypy", *config, *map(str, files)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.returncode in (0, 1), done.stderr
    return [line for line in done.stdout.splitlines() if ": error: " in line]
