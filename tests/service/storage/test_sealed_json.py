"""Records survive the way through storage, and any change on it is noticed."""

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import TypeAdapter

from panoloc.core.camera.camera import CameraDescription
from panoloc.core.options import Hints, IndexOptions, ScanOptions, SessionOptions
from panoloc.service.batches.record import BATCH, BatchRecord
from panoloc.service.errors import StoredFileDamagedError
from panoloc.service.jobs import QueryOptions, RegisterOptions
from panoloc.service.storage.sealed_json import seal, unseal

HINTS = Hints((1.0, 2.0, 3.0), 4.0, ((0.0, 0.0, 0.0), (5.0, 6.0, 7.0)), True, 10.0, 90.0, 45.0)
RECORD = BatchRecord(
    id="batch_1",
    created_at="2026-11-22T08:00:00.000000Z",
    map_ids=("map_a", "map_b"),
    tag=None,
    options=QueryOptions(30.0, "paper", "webxr", SessionOptions(True), HINTS, (), 3),
    camera=CameraDescription("opencv", 640, 480, 500.0, 501.0, 320.0, 240.0, (0.1, 0.0, 0.0, 0.0)),
    names=("a.jpg", "b/ä.jpg"),
    ignored=("notes.txt",),
)
PLAIN = BatchRecord("batch_2", "2026-11-22T08:00:00.000000Z", (), "hall", QueryOptions(60.0), None, ("a.jpg",))
REGIONS = st.none() | st.tuples(*[st.floats(-1e6, 1e6)] * 3).map(lambda low: (low, tuple(value + 1.5 for value in low)))
KINDS = st.sampled_from(["rgb", "labels"])


@pytest.mark.parametrize("record", [RECORD, PLAIN])
def test_a_batch_is_read_as_it_was_written(record: BatchRecord) -> None:
    assert unseal(BATCH, seal(BATCH, record), "key") == record


@given(
    st.builds(
        ScanOptions,
        st.sampled_from(["m", "us-ft"]),
        st.sampled_from(["z", "-y"]),
        st.sampled_from(["ft", "auto"]),
        color_kind=KINDS,
    ),
    st.builds(
        IndexOptions, st.sampled_from(["octree", "grid"]), st.none() | st.floats(0.05, 50), REGIONS, color_kind=KINDS
    ),
)
def test_options_of_a_scan_are_read_as_they_were_written(scan: ScanOptions, index: IndexOptions) -> None:
    kind = TypeAdapter(RegisterOptions)
    assert unseal(kind, seal(kind, RegisterOptions(scan, index)), "key") == RegisterOptions(scan, index)


def test_a_changed_record_is_damaged() -> None:
    whole = seal(BATCH, RECORD)
    for data in (whole.replace(b"map_b", b"map_c"), b"{}", b"[]", b"no json", whole[:-9]):
        with pytest.raises(StoredFileDamagedError, match=r"an unchanged record of the service.*restore the file"):
            unseal(BATCH, data, "key")


@pytest.mark.parametrize("change", [{"camera": {"model": "pinhole"}}, {"options": {"method": "magic"}}, {"other": 1}])
def test_a_record_that_no_service_wrote_is_damaged(change: dict[str, Any]) -> None:
    kind = TypeAdapter(dict[str, Any])
    written = json.loads(seal(BATCH, RECORD))["record"]
    with pytest.raises(StoredFileDamagedError, match="restore the file"):
        unseal(BATCH, seal(kind, written | change), "key")
