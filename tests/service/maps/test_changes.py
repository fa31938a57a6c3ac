"""What answers saw changed is counted while it lives, by revision, and nothing of it outlives its map."""

import base64
import struct
import zlib
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from panoloc.service.jobs import ChangePhoto, MapRef
from panoloc.service.maps.changes import MOST_ANSWERS, ChangeLog, Period
from panoloc.service.storage import FolderStorage

pytestmark = pytest.mark.anyio

REF = MapRef("map_a", 1)
NO_OFFSET = [0.0, 0.0, 0.0]
PHOTO, OTHER_PHOTO = [b"one"], [b"two"]


@pytest.fixture
def log(tmp_path: Path) -> ChangeLog:
    return ChangeLog(FolderStorage(tmp_path))


def packed(*cells: tuple[int, int, int]) -> str:
    """Return cells as a worker packs them."""
    return base64.b64encode(zlib.compress(b"".join(struct.pack("<3h", *cell) for cell in cells))).decode()


def seen(*cells: tuple[int, int, int], changed: tuple[tuple[int, int, int], ...] = ()) -> dict[str, Any]:
    """Return cells as a worker reports them."""
    return {"cell_m": 0.5, "seen": packed(*cells), "changed": packed(*changed)}


def answer(number: int = 1, revision: int = 1, frame: str = "ros") -> dict[str, Any]:
    """Return the parts of an answer that are kept."""
    return {
        "id": f"loc_{number}",
        "map_id": "map_a",
        "map_revision": revision,
        "pose": {"frame": frame, "map_from_camera": {"position_m": {"x": 1.0, "y": 2.0, "z": 3.0}}},
        "confidence": 0.9,
        "change": {"panorama_changed_fraction": 0.2, "map_changed_fraction": 0.1},
    }


def test_cells_are_counted_over_answers_and_placed_in_the_maps_own_frame(log: ChangeLog) -> None:
    log.note(answer(1), seen((0, 0, 0), (1, -1, 0), changed=((1, -1, 0),)), PHOTO)
    log.note(answer(2), seen((1, -1, 0), (4, 4, 4), changed=((1, -1, 0), (4, 4, 4))), OTHER_PHOTO)
    found = log.document(REF, [100.0, 0.0, 0.0], Period())
    assert [each["id"] for each in found["answers"]] == ["loc_2", "loc_1"]
    counted = [(cell["center_m"], cell["num_changed"], cell["num_seen"]) for cell in found["cells"]]
    assert counted == [([100.75, -0.25, 0.25], 2, 2), ([102.25, 2.25, 2.25], 1, 1)]


def test_the_same_photo_sent_again_is_no_second_witness(log: ChangeLog) -> None:
    log.note(answer(1), seen((0, 0, 0), changed=((0, 0, 0),)), PHOTO)
    log.note(answer(2), seen((0, 0, 0), changed=((0, 0, 0),)), OTHER_PHOTO)
    log.note(answer(3), seen((0, 0, 0), (1, 1, 1), changed=((1, 1, 1),)), PHOTO)
    log.note(answer(4), seen((0, 0, 0)), [*PHOTO, *OTHER_PHOTO])
    found = log.document(REF, NO_OFFSET, Period())
    assert [each["id"] for each in found["answers"]] == ["loc_4", "loc_3", "loc_2"]
    assert sorted((each["num_changed"], each["num_seen"]) for each in found["cells"]) == [(1, 1), (1, 3)]


def test_where_a_photo_was_taken_is_said_in_the_maps_axes_whatever_axes_were_asked_for(log: ChangeLog) -> None:
    log.note(answer(frame="webxr"), seen(), PHOTO)
    assert log.document(REF, NO_OFFSET, Period())["answers"][0]["position_m"] == [1.0, -3.0, 2.0]


def test_answers_to_a_former_scan_do_not_count(log: ChangeLog) -> None:
    log.note(answer(revision=1), seen((0, 0, 0), changed=((0, 0, 0),)), PHOTO)
    assert log.document(MapRef("map_a", 2), NO_OFFSET, Period())["cells"] == []


def test_an_answer_counts_for_its_lifetime(tmp_path: Path, log: ChangeLog) -> None:
    log.note(answer(), seen((0, 0, 0)), PHOTO)
    (kept,) = (tmp_path / "changes" / "map_a").iterdir()
    kept.rename(kept.with_name("20200101T000000000000-loc_1-00.json"))
    assert log.document(REF, NO_OFFSET, Period())["answers"] == []
    log.note(answer(2), seen((0, 0, 0)), OTHER_PHOTO)
    assert len(list((tmp_path / "changes" / "map_a").iterdir())) == 1


def test_the_oldest_answers_make_room(log: ChangeLog, tmp_path: Path) -> None:
    (folder := tmp_path / "changes" / "map_a").mkdir(parents=True)
    for number in range(MOST_ANSWERS + 2):
        (folder / f"29990101T{number:012}-loc_{number}-{number}.json").touch()
    log.note(answer(), seen((0, 0, 0)), PHOTO)
    assert len(list((tmp_path / "changes" / "map_a").iterdir())) == MOST_ANSWERS


def test_what_cannot_be_read_leaves_the_others(log: ChangeLog, tmp_path: Path) -> None:
    log.note(answer(1), seen((0, 0, 0)), PHOTO)
    log.note(answer(2), seen((0, 0, 0)), OTHER_PHOTO)
    first, _ = sorted((tmp_path / "changes" / "map_a").iterdir())
    first.write_text("{")
    assert [each["id"] for each in log.document(REF, NO_OFFSET, Period())["answers"]] == ["loc_2"]


def test_nothing_is_left_of_a_map_that_is_forgotten(log: ChangeLog, tmp_path: Path) -> None:
    log.note(answer(), seen((0, 0, 0)), PHOTO)
    log.forget("map_a")
    assert not (tmp_path / "changes" / "map_a").exists()


SMALL = ChangePhoto(b"webp", (1.0, 2.0, 3.0), (0.0, 0.0, 0.0, 1.0))


def test_a_small_photo_lives_as_long_as_its_answer_and_its_batch(log: ChangeLog, tmp_path: Path) -> None:
    log.note(answer(1), seen((0, 0, 0)), PHOTO, SMALL, "batch_a")
    log.note(answer(2), seen((0, 0, 0)), OTHER_PHOTO, SMALL)
    log.note(answer(3), seen((0, 0, 0)), [b"three"])
    assert [photo["position_m"] for photo in log.photos(REF, Period())] == [[1.0, 2.0, 3.0]] * 2
    log.forget_batch("batch_a")
    kept = [path.name for path in (tmp_path / "change-photos").rglob("*.webp")]
    assert kept == ["loc_2.webp"]
    log.note(answer(4), seen((0, 0, 0)), OTHER_PHOTO)  # the same photo again, now without one to keep
    log.forget("map_a")
    assert not list((tmp_path / "change-photos").rglob("*.webp"))


def test_days_count_whole_and_in_utc() -> None:
    day = Period.between("2026-11-21", "2026-11-21")
    assert day.has(datetime(2026, 11, 21, tzinfo=UTC))
    assert day.has(datetime(2026, 11, 21, 23, 59, 59, tzinfo=UTC))
    assert not day.has(datetime(2026, 11, 22, tzinfo=UTC))
    assert not day.has(datetime(2026, 11, 20, 23, 59, 59, tzinfo=UTC))
    assert Period.between("2026-11-21T12:00:00+01:00", None).has(datetime(2026, 11, 21, 11, tzinfo=UTC))


def test_only_answers_of_the_period_count(log: ChangeLog) -> None:
    log.note(answer(1), seen((0, 0, 0), changed=((0, 0, 0),)), PHOTO, SMALL)
    hour = timedelta(hours=1)
    now = datetime.now(UTC)
    for period, count in ((Period(now - hour), 1), (Period(now + hour), 0), (Period(until=now - hour), 0)):
        found = log.document(REF, NO_OFFSET, period)
        assert len(found["answers"]) == len(found["cells"]) == len(log.photos(REF, period)) == count
