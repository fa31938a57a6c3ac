"""From a scan and three photos of a room that was rearranged to a zip with objects and pictures, as the service asks for it."""

import io
import json
import zipfile
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from panoloc.core.changes.__main__ import main
from panoloc.core.scan.ply.writer import write_ply
from panoloc.lab.rooms.changed_rooms import make_changed_room


@pytest.mark.slow
def test_objects_of_a_rearranged_room_are_found_where_they_are_and_shown(tmp_path: Path) -> None:
    room = make_changed_room(6003, width=512)
    write_ply(tmp_path / "points.ply", room.cloud)
    photos = []
    for number, (panorama, pose) in enumerate(zip(room.panoramas, room.poses, strict=True)):
        Image.fromarray(panorama.color).save(tmp_path / f"{number}.webp")
        place = {"position_m": pose.position.tolist(), "quaternion_xyzw": pose.quaternion_xyzw.tolist()}
        photos.append({"image": str(tmp_path / f"{number}.webp"), "time": f"2026-11-2{number}T12:00:00Z", **place})
    (tmp_path / "question.json").write_text(json.dumps({"points": str(tmp_path / "points.ply"), "photos": photos}))
    assert main([str(tmp_path / "question.json"), str(tmp_path / "out.zip")]) == 0
    with zipfile.ZipFile(tmp_path / "out.zip") as archive:
        objects = json.loads(archive.read("objects.json"))
        pictures = {name: Image.open(io.BytesIO(archive.read(name))).size for name in archive.namelist()[1:]}
    large = [each for each in room.objects if each.largest_side_m > 0.3 and each.seen_sr > 0.02]
    places = [np.array(each[name]) for each in objects for name in ("center_m", "from_m") if each[name] is not None]
    near = [min(float(np.linalg.norm(each.center - place)) for place in places) < 0.3 for each in large]
    assert sum(near) > len(large) / 2
    for each in objects:
        assert 0 < each["certainty"] < 1
        assert 1 <= each["num_photos"] <= 3
        assert pictures[f"{each['id']}.jpg"][0] == 644
        assert "2026-11-20" <= each["first_seen_at"] <= each["last_seen_at"]
