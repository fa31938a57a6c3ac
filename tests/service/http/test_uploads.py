"""Multipart bodies however they are cut into pieces, and disks without space."""

import asyncio
import errno
import hashlib
import itertools
import tempfile
from collections.abc import AsyncIterator, Callable
from pathlib import Path

import httpx
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from panoloc.service.errors import InvalidOptionsError, MalformedRequestError, StorageFullError, UploadTooLargeError
from panoloc.service.http.uploads import Form, PartRule, Spool, read_form

RULES = {"file": PartRule(10_000, "PANOLOC_MAX_UPLOAD_BYTES", spooled=True), "tag": PartRule(max_parts=999)}
SCAN = b"1 2 3 4 5 6\r\n--x\r\n" * 40


def body_of(*parts: tuple[str, tuple[str | None, str | bytes]]) -> tuple[bytes, dict[str, str]]:
    """Return the bytes of a form, and the headers that go with them."""
    of_scan = ("tag", (None, "ä")), ("file", ("söme scan.XYZ", SCAN)), ("tag", (None, ""))
    request = httpx.Request("POST", "http://panoloc", files=[*(parts or of_scan)])
    return request.read(), {"content-type": request.headers["content-type"]}


def read(pieces: list[bytes], headers: dict[str, str], folder: Path, check: Callable[[Form], None]) -> None:
    """Read a form from pieces of its body, and check it before it is left."""

    async def chunks() -> AsyncIterator[bytes]:
        for piece in pieces:
            yield piece

    async def checked() -> None:
        async with read_form(chunks(), headers, RULES, folder) as form:
            check(form)

    asyncio.run(checked())


def refused(pieces: list[bytes], headers: dict[str, str], folder: Path) -> None:
    read(pieces, headers, folder, lambda form: pytest.fail(f"read {form}"))


@settings(max_examples=40)
@given(st.lists(st.integers(1, 2000), max_size=8))
def test_a_form_is_the_same_however_it_is_cut(cuts: list[int]) -> None:
    body, headers = body_of()
    places = sorted({0, len(body), *(cut for cut in cuts if cut < len(body))})
    pieces = [body[a:b] for a, b in itertools.pairwise(places)]

    def check(form: Form) -> None:
        (scan,) = form.files["file"]
        assert scan.path.read_bytes() == SCAN
        assert (scan.name, scan.num_bytes) == ("söme scan.XYZ", len(SCAN))
        assert scan.sha256 == hashlib.sha256(SCAN).hexdigest()
        assert form.texts("tag") == ["ä", ""]

    with tempfile.TemporaryDirectory() as folder:
        read(pieces, headers, Path(folder), check)
        assert list(Path(folder).iterdir()) == [], "left by a form that nobody took it from"


@pytest.mark.parametrize("share", [0.1, 0.5, 0.99])
def test_a_body_that_ends_early_is_malformed_and_leaves_nothing(tmp_path: Path, share: float) -> None:
    body, headers = body_of()
    with pytest.raises(MalformedRequestError, match="got a truncated one"):
        refused([body[: int(share * len(body))]], headers, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_too_many_parts_are_refused(tmp_path: Path) -> None:
    body, headers = body_of(*[("tag", (None, "x"))] * 200)
    with pytest.raises(UploadTooLargeError, match="128 parts"):
        refused([body], headers, tmp_path)


def test_a_part_without_headers_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidOptionsError, match="expected only the parts file, tag, got ''"):
        refused([b"--x\r\n\r\nnothing\r\n--x--"], {"content-type": "multipart/form-data; boundary=x"}, tmp_path)


def test_a_boundary_that_is_far_too_long_is_malformed(tmp_path: Path) -> None:
    with pytest.raises(MalformedRequestError, match="Boundary length 5000"):
        refused([b""], {"content-type": f"multipart/form-data; boundary={'a' * 5000}"}, tmp_path)


def test_a_field_is_not_a_way_to_fill_the_memory(tmp_path: Path) -> None:
    body, headers = body_of(*[("tag", (None, "x" * 70_000))])
    with pytest.raises(UploadTooLargeError, match="tag: expected at most 65,536 bytes"):
        refused([body], headers, tmp_path)


def test_a_disk_that_fills_up_with_the_last_bytes_is_said_to_be_full_and_nothing_is_left(tmp_path: Path) -> None:
    spool = Spool(tmp_path, "a.xyz", RULES["file"])
    spool.add(SCAN)

    class FullAtTheEnd:
        def write(self, data: bytes) -> None:
            """Take the bytes into a buffer."""

        def close(self) -> None:
            raise OSError(errno.ENOSPC, "No space left on device")

    spool._file.close()
    spool._file = FullAtTheEnd()  # type: ignore[assignment]
    with pytest.raises(StorageFullError):
        spool.finish()
    spool.discard()
    assert list(tmp_path.iterdir()) == []
