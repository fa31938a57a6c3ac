"""What callers get for input that is wrong: a status, a message that helps, and the next good request answered."""

import urllib.error
import urllib.request
from collections.abc import AsyncIterator

import pytest

from panoloc.core.errors import ScanTooLargeError
from panoloc.service.http.guards import slow_clients
from tests.core.image.picture_files import encoded, picture
from tests.service.http.fake_pool import ply_of
from tests.service.http.running_service import SCAN, Listen, RunningService, Serve, png_of

pytestmark = pytest.mark.anyio

JPEG_WITHOUT_SIZE = b"\xff\xd8\xff\xe0\x00\x10JFIF"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scan", "name", "status", "says"),
    [
        (b"", "a.ply", 422, "empty"),
        (SCAN[:-1], "a.ply", 422, "cut off"),
        (ply_of([(0, 0, 0)] * 100)[:700], "a.ply", 422, "100 points"),
        (png_of(8, 4), "a.ply", 415, "a PNG image"),
        (b"\x1f\x8b\x08 gzip", "a.ply", 415, "unpack it first"),
        (b"hello, this is no point cloud\n", "a.ply", 415, "without that format's header"),
        (bytes(range(256)) * 40, "a.xyz", 415, "unknown binary data"),
        (b"ply\nformat ascii 1.0\nelement vertex 999999999\nend_header\n", "a.ply", 413, "PANOLOC_MAX_POINTS"),
    ],
)
async def test_a_scan_that_is_none_is_refused_at_the_upload(
    running: RunningService, scan: bytes, name: str, status: int, says: str
) -> None:
    reply = await running.upload(scan, name)
    problem = reply.json()
    assert (reply.status_code, problem["status"]) == (status, status)
    assert reply.headers["content-type"] == "application/problem+json"
    assert says in problem["detail"]
    assert problem["detail"].startswith("expected")
    assert problem["request_id"] == reply.headers["x-request-id"]
    assert running.storage.names("maps") == []
    assert running.storage.names("uploads") == []
    await running.ready_map()


@pytest.mark.parametrize(
    ("head", "name"),
    [
        (b"# .PCD v0.7\nVERSION .7\nFIELDS x y z rgb\n", "a.pcd"),
        (b"VERSION 0.7\nFIELDS x y z\n", "a.pcd"),
        (b"LASF" + bytes(100), "a.laz"),
        (b"ASTM-E57" + bytes(100), "scan"),
        (b"1.0 2.0 3.0 255 255 255\n" * 500, "a.xyz"),
        (b"1.0,2.0,3.0\n", "points"),
        (b"ply\r\nformat ascii 1.0\r\n", "a.txt"),
    ],
)
async def test_a_scan_that_may_be_one_goes_to_a_worker(running: RunningService, head: bytes, name: str) -> None:
    assert (await running.upload(head, name)).status_code == 202


@pytest.mark.parametrize(
    ("image", "status", "says"),
    [
        (b"", 415, "empty file"),
        (b"/home/me/photo.jpg", 415, "got text ('/home/me/photo.jpg'); send the content of the file, not its name"),
        (b"GIF89a........", 415, "JPEG, PNG, WebP, HEIC or AVIF"),
        (JPEG_WITHOUT_SIZE, 422, "ends within its header"),
        (png_of(40_000, 20_000), 413, "40,000 x 20,000"),
    ],
)
async def test_an_image_that_is_none_never_reaches_a_worker(
    running: RunningService, image: bytes, status: int, says: str
) -> None:
    map_id = await running.ready_map()
    reply = await running.localize(map_id, image)
    assert reply.status_code == status
    assert says in reply.json()["detail"]
    assert running.pool.jobs == []
    assert (await running.localize(map_id)).status_code == 200


async def test_a_photo_of_an_unknown_camera_never_reaches_a_worker(running: RunningService) -> None:
    map_id, photo = await running.ready_map(), encoded(picture(64, 48), "JPEG")
    reply = await running.localize(map_id, photo)
    assert reply.status_code == 422
    assert reply.json()["type"].endswith("not-a-panorama")
    assert "64 x 48 (1.33:1) without camera data" in reply.json()["detail"]
    assert running.pool.jobs == []
    reply = await running.localize(map_id, photo, options='{"cameras": [{"model": "pinhole", "hfov_deg": 69}]}')
    assert reply.status_code == 200


@pytest.mark.parametrize(
    ("mask", "status", "kind"),
    [
        (b"this is text", 415, "unknown-mask-format"),
        (JPEG_WITHOUT_SIZE, 422, "mask-damaged"),
        (png_of(40_000, 20_000), 413, "mask-too-many-pixels"),
    ],
)
async def test_a_mask_that_is_no_image_is_not_taken_for_a_bad_panorama(
    running: RunningService, mask: bytes, status: int, kind: str
) -> None:
    reply = await running.localize(await running.ready_map(), files={"mask": ("mask.png", mask)})
    problem = reply.json()
    assert (reply.status_code, problem["type"]) == (status, f"/problems/{kind}")
    assert "mask" in problem["title"]
    assert problem["detail"].startswith("mask: expected")
    assert problem["fields"] == [{"field": "mask", "message": problem["detail"]}]
    assert running.pool.jobs == []


async def test_a_timeout_that_the_service_does_not_allow_names_the_setting_to_raise(running: RunningService) -> None:
    reply = await running.localize(await running.ready_map(), options='{"timeout_s": 601}')
    assert reply.status_code == 422
    assert "at most 600 seconds, got 601" in reply.json()["detail"]
    assert "raise PANOLOC_MAX_TIMEOUT_S" in reply.json()["detail"]
    assert running.pool.jobs == []


@pytest.mark.parametrize("options", ["{", "nonsense", "[" * 5000])
async def test_options_that_are_no_json_are_malformed(running: RunningService, options: str) -> None:
    reply = await running.localize(await running.ready_map(), options=options)
    assert reply.status_code == 400
    assert reply.json()["detail"].startswith("options: expected JSON")


@pytest.mark.parametrize("data", [{}, {"map_id": "map_1", "tag": "x"}])
async def test_maps_are_named_by_id_or_by_tag(running: RunningService, data: dict[str, str]) -> None:
    reply = await running.client.post("/localize", data=data, files={"image": ("a.png", png_of(8, 4))})
    assert reply.status_code == 422
    assert "either map_id (repeatable) or tag" in reply.json()["detail"]


async def test_parts_that_nobody_knows_are_named(running: RunningService) -> None:
    files: dict[str, tuple[str | None, bytes]] = {"image": ("a.png", png_of(8, 4)), "map_ids": (None, b"map_1")}
    reply = await running.client.post("/localize", files=files)
    assert reply.status_code == 422
    assert "'map_ids'" in reply.json()["detail"]


async def test_a_part_that_is_missing_is_named(running: RunningService) -> None:
    reply = await running.client.post("/localize", files={"map_id": (None, await running.ready_map())})
    assert reply.json()["fields"][0]["field"] == "image"
    reply = await running.client.post("/maps", files={"options": (None, "{}")})
    assert reply.json()["fields"][0]["field"] == "file"


async def test_a_part_that_comes_twice_is_refused(running: RunningService) -> None:
    files = [("file", ("a.ply", SCAN)), ("file", ("b.ply", SCAN))]
    assert (await running.client.post("/maps", files=files)).status_code == 422
    assert running.storage.names("uploads") == []


@pytest.mark.parametrize(
    ("headers", "body"),
    [
        ({}, b"{}"),
        ({"content-type": "application/json"}, b"{}"),
        ({"content-type": "multipart/form-data"}, b"--x--"),
        ({"content-type": "multipart/form-data; boundary=x"}, b""),
        ({"content-type": "multipart/form-data; boundary=x"}, b"nonsense"),
        (
            {"content-type": "multipart/form-data; boundary=x"},
            b'--x\r\nContent-Disposition: form-data; name="options"\r\n\r\n{',
        ),
    ],
)
@pytest.mark.parametrize("path", ["/maps", "/localize"])
async def test_a_body_that_is_no_form_is_malformed(
    running: RunningService, path: str, headers: dict[str, str], body: bytes
) -> None:
    reply = await running.client.post(path, headers=headers, content=body)
    assert reply.status_code == 400
    assert reply.json()["type"] == "/problems/malformed-request"
    assert running.storage.names("uploads") == []


@pytest.mark.parametrize(
    "path", ["/maps/map_none", "/maps/..%2f..%2fetc", "/maps/map_none/points", "/localizations/loc_none", "/nowhere"]
)
async def test_what_is_not_there_is_a_404_problem(running: RunningService, path: str) -> None:
    reply = await running.client.get(path)
    assert reply.status_code == 404
    assert reply.headers["content-type"] == "application/problem+json"


async def test_a_wrong_method_names_the_right_ones(running: RunningService) -> None:
    reply = await running.client.put("/maps")
    assert reply.status_code == 405
    assert reply.json()["type"] == "/problems/method-not-allowed"
    assert reply.headers["allow"] == "GET, POST"
    assert reply.json()["detail"] == "expected GET or POST at this path, got PUT /maps"


@pytest.mark.parametrize(
    "query", [{"limit": "0"}, {"limit": "201"}, {"limit": "x"}, {"cursor": "!"}, {"cursor": "e30"}]
)
async def test_a_page_that_cannot_be_is_refused(running: RunningService, query: dict[str, str]) -> None:
    reply = await running.client.get("/maps", params=query)
    assert reply.status_code == 422
    assert reply.json()["fields"][0]["field"] == next(iter(query))


async def test_an_upload_over_the_limit_is_not_read_to_its_end(serve: Serve, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(slow_clients, "_MOST_LINGER_BYTES", 0)
    read = 0

    async def endless() -> AsyncIterator[bytes]:
        nonlocal read
        yield b'--x\r\nContent-Disposition: form-data; name="file"; filename="a.xyz"\r\n\r\n'
        while True:
            read += 1
            yield b"1 2 3 4 5 6\n" * 1000

    async with serve(max_upload_bytes=100_000) as small:
        headers = {"content-type": "multipart/form-data; boundary=x"}
        reply = await small.client.post("/maps", headers=headers, content=endless())
        assert reply.status_code == 413
        assert "100,000 bytes (PANOLOC_MAX_UPLOAD_BYTES)" in reply.json()["detail"]
        assert read < 20
        assert small.storage.names("uploads") == []
        read = 0
        declared = {**headers, "content-length": "999999999"}
        assert (await small.client.post("/maps", headers=declared, content=endless())).status_code == 413
        assert read <= 1


@pytest.mark.parametrize(
    ("path", "part", "times", "status", "said"),
    [
        ("/maps", b'name="file"; filename="a.xyz"\r\n\r\n' + bytes(20_000_000), 1, 413, b"PANOLOC_MAX_UPLOAD_BYTES"),
        ("/localize", b'name="image"; filename="a.png"\r\n\r\n' + bytes(1_000_000), 50, 422, b"at most 32 parts"),
    ],
)
def test_a_client_that_sends_first_and_reads_later_learns_why_it_was_refused(
    listen: Listen, path: str, part: bytes, times: int, status: int, said: bytes
) -> None:
    body = (b"--x\r\nContent-Disposition: form-data; " + part + b"\r\n") * times + b"--x--\r\n"
    headers = {"Content-Type": "multipart/form-data; boundary=x"}
    with listen(max_upload_bytes=100_000) as url, pytest.raises(urllib.error.HTTPError) as caught:
        urllib.request.urlopen(urllib.request.Request(f"{url}{path}", body, headers))
    assert caught.value.code == status
    assert said in caught.value.read()


async def test_a_scan_with_too_many_points_is_the_same_problem_at_the_upload_and_in_the_worker(
    running: RunningService,
) -> None:
    refused = await running.upload(b"ply\nformat ascii 1.0\nelement vertex 999999999\nend_header\n", "a.ply")
    running.pool.fail_register = [ScanTooLargeError("expected a scan of at most 5 points, got 6; thin the scan")]
    failed = await running.settled((await running.upload()).json()["id"])
    assert failed["error"]["type"] == refused.json()["type"] == "/problems/too-many-points"
