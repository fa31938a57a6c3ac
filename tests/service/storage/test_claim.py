"""Services that do not share a bucket keep each other out of it; a dead one keeps the next one out for seconds only."""

import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from panoloc.service.storage.bucket import BucketStorage
from panoloc.service.storage.claim import BucketClaim, BucketUnusableError
from tests.service.storage.bucket_server import BucketServer

# Long enough for a busy machine to renew in.
RENEW_S, WATCH_S = 0.1, 3.0
OF_ANOTHER = b'{"token": "of another", "is_shared": false, "machine": "m", "process": 7}'
Claims = Callable[..., BucketClaim]


@pytest.fixture
def claim(
    bucket_server: BucketServer, prefix: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Claims]:
    """Return a function that makes the claim of a service on a machine of its own."""
    monkeypatch.setattr("panoloc.service.storage.claim._RENEW_S", RENEW_S)
    monkeypatch.setattr("panoloc.service.storage.claim._WATCH_S", WATCH_S)
    made = []

    def of(machine: str, is_shared: bool = False) -> BucketClaim:
        folder = tmp_path / machine
        folder.mkdir(exist_ok=True)
        made.append(BucketClaim(bucket_server.storage(folder, prefix), folder, is_shared=is_shared))
        return made[-1]

    yield of
    for each in made:
        each.release()


def kill(claim: BucketClaim) -> None:
    claim._stopping.set()
    claim._thread.join()


@pytest.mark.slow
@pytest.mark.parametrize(("first", "second"), [(False, False), (False, True), (True, False)])
def test_a_service_keeps_out_who_does_not_share_with_it(claim: Claims, first: bool, second: bool) -> None:
    claim("one", first).take()
    with pytest.raises(BucketUnusableError, match=r"the service with process id \d+ on .* is using it"):
        claim("two", second).take()


def test_those_who_share_let_each_other_in(claim: Claims) -> None:
    claim("one", True).take()
    claim("two", True).take()


def test_one_that_stops_lets_the_next_one_in_at_once(claim: Claims) -> None:
    one = claim("one")
    one.take()
    one.release()
    began = time.monotonic()
    claim("two").take()
    assert time.monotonic() - began < WATCH_S / 2


@pytest.mark.slow
def test_one_that_was_killed_keeps_others_out_for_a_while_and_itself_not_at_all(
    claim: Claims, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = claim("one")
    one.take()
    kill(one)
    began = time.monotonic()
    again = claim("one")
    again.take()
    assert time.monotonic() - began < WATCH_S / 2
    kill(again)
    monkeypatch.setattr("panoloc.service.storage.claim._WATCH_S", 1.0)
    began = time.monotonic()
    claim("two").take()
    assert time.monotonic() - began >= 1.0


@pytest.mark.parametrize("is_shared", [False, True])
def test_one_that_stood_still_learns_that_another_has_the_bucket_and_leaves_it(
    claim: Claims, bucket: BucketStorage, is_shared: bool
) -> None:
    one, lost = claim("one", is_shared), threading.Event()
    one.when_lost = lost.set
    one.take()
    bucket.put("claim.json", OF_ANOTHER)
    assert lost.wait(10)
    assert one.loss == "the service with process id 7 on m has taken the bucket"
    one.release()
    assert b"of another" in bucket.read("claim.json")


def test_one_that_stops_before_it_learns_that_leaves_the_other_alone(
    claim: Claims, bucket: BucketStorage, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = claim("one")
    monkeypatch.setattr("panoloc.service.storage.claim._RENEW_S", 1000.0)
    one.take()
    bucket.put("claim.json", OF_ANOTHER)
    one.release()
    assert one.loss is None
    assert b"of another" in bucket.read("claim.json")


@pytest.mark.parametrize("note", [b"", b"[]", b"{}"])
def test_a_note_that_cannot_be_read_keeps_nobody_out(claim: Claims, bucket: BucketStorage, note: bytes) -> None:
    bucket.put("claim.json", note)
    claim("one").take()
