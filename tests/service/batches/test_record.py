"""Records of batches survive the way through storage, and nothing but the way."""

import pytest

from core.camera.camera import CameraDescription
from core.options import Hints, SessionOptions
from service.batches.record import BatchRecord
from service.errors import StoredFileDamagedError
from service.jobs import QueryOptions

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


@pytest.mark.parametrize("record", [RECORD, PLAIN])
def test_a_record_is_read_as_it_was_written(record: BatchRecord) -> None:
    assert BatchRecord.from_json(record.to_json(), "key") == record


def test_a_changed_record_is_noticed() -> None:
    for data in (RECORD.to_json().replace(b"map_b", b"map_c"), b"{}", b"[]", b"no json", RECORD.to_json()[:-9]):
        with pytest.raises(StoredFileDamagedError, match="batch as the service wrote it"):
            BatchRecord.from_json(data, "key")
