"""Control points over HTTP: stored, compared, applied by PATCH, and refused."""

from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from panoloc.core.earth.geopose import Georeference, earth_pose
from panoloc.core.earth.georeference import coordinate_system
from panoloc.core.geometry.pose import Pose
from panoloc.service.http.schemas.control import ControlReport
from panoloc.service.keys.caller import Scope
from panoloc.service.keys.key_file import KeyFile
from tests.service.http.running_service import RunningService, Serve

pytestmark = pytest.mark.anyio
TRUTH = Georeference(48.1371, 11.5754, 562.3, 37.25)
CORNERS = ((0.0, 0.0, 0.2), (30.0, 0.0, 1.0), (0.0, 20.0, 2.5), (30.0, 20.0, 6.0))


def csv_of(with_places: bool) -> str:
    lines = ["name,lat,lon,height" + (",map_x,map_y,map_z" if with_places else "")]
    for number, at in enumerate(CORNERS):
        there = earth_pose(TRUTH, Pose(np.eye(3), np.array(at)))
        cells = [f"P{number}", there.latitude_deg, there.longitude_deg, there.height_m, *(at if with_places else ())]
        lines.append(",".join(map(str, cells)))
    return "\n".join(lines)


async def put(running: RunningService, map_id: str, **body: Any) -> Any:
    reply = await running.client.put(f"/maps/{map_id}/control-points", json=body)
    assert reply.status_code == 200, reply.text
    ControlReport.model_validate(reply.json())
    return reply.json()


async def test_points_give_a_map_its_place_and_then_agree_with_it(running: RunningService) -> None:
    map_id = await running.ready_map()
    assert (await running.json(f"/maps/{map_id}/control-points"))["points"] == []
    report = await put(running, map_id, csv=csv_of(with_places=True))
    assert (report["as_is"], report["fit"]["num_points"]) == (None, 4)
    assert report["fit"]["rms_m"] < 1e-4
    found = report["fit"]["georeference"]
    assert found == pytest.approx(vars(TRUTH), abs=1e-4)
    assert (await running.client.patch(f"/maps/{map_id}", json={"georeference": found})).status_code == 200
    report = await running.json(f"/maps/{map_id}/control-points")
    assert report["as_is"]["rms_m"] < 0.001
    assert report["points"][0]["as_is"]["distance_m"] < 0.001


async def test_a_map_that_got_its_place_from_points_of_a_grid_tells_positions_on_that_grid(
    running: RunningService,
) -> None:
    map_id = await running.ready_map()
    grid, undulation_m = coordinate_system("EPSG:25832"), 46.2
    lines, known = ["name,x,y,z,map_x,map_y,map_z"], []
    for number, at in enumerate(CORNERS):
        there = earth_pose(TRUTH, Pose(np.eye(3), np.array(at)))
        position = grid.grid_position(there.latitude_deg, there.longitude_deg)
        assert position is not None
        known.append((*position, there.height_m - undulation_m))
        lines.append(",".join(map(str, (f"P{number}", *known[-1], *at))))
    sent = {"csv": "\n".join(lines), "coordinate_system": "EPSG:25832", "geoid_undulation_m": undulation_m}
    found = (await put(running, map_id, **sent))["fit"]["georeference"]
    at_p3 = {"x": CORNERS[3][0], "y": CORNERS[3][1], "z": CORNERS[3][2]}
    before = (await running.client.get(f"/maps/{map_id}/coordinates", params=at_p3)).json()
    assert (before["grid"], before["wgs84"]) == (None, None)
    await running.client.patch(f"/maps/{map_id}", json={"georeference": found})
    told = (await running.client.get(f"/maps/{map_id}/coordinates", params=at_p3)).json()["grid"]
    assert (told["coordinate_system"], told["unit"]) == ("EPSG:25832", "m")
    assert [told["east"], told["north"], told["height_m"]] == pytest.approx(known[3], abs=0.001)


async def test_a_clicked_place_outlives_a_new_list_of_coordinates(running: RunningService) -> None:
    map_id = await running.ready_map()
    await put(running, map_id, csv=csv_of(with_places=True))
    report = await put(running, map_id, csv=csv_of(with_places=False))
    assert [point["position_m"] for point in report["points"]] == [list(at) for at in CORNERS]
    assert report["fit"]["num_points"] == 4
    await running.replace_scan(map_id)
    await running.eventually(f"/maps/{map_id}", lambda body: body["serving_revision"] == 2)
    assert "revision 1" in (await running.json(f"/maps/{map_id}/control-points"))["warnings"][-1]
    report = await put(running, map_id, csv=csv_of(with_places=False))
    assert report["points"][0]["position_m"] is None
    assert "click more" in report["no_fit"]


async def test_places_far_outside_of_the_scan_are_told(running: RunningService) -> None:
    map_id = await running.ready_map()
    at = {"x": 1, "y": 2, "z": 3}
    report = await put(
        running,
        map_id,
        points=[{"name": "A", **at, "position_m": [1, 1, 1]}, {"name": "B", **at, "position_m": [900, 1, 1]}],
    )
    assert report["warnings"] == [
        "B: the place in the scan is more than 50 m outside of the scan; check its unit and columns"
    ]


async def test_nothing_of_the_points_outlives_the_map(running: RunningService) -> None:
    map_id = await running.ready_map()
    await put(running, map_id, points=[{"name": "A", "x": 1, "y": 2, "z": 3, "position_m": [1, 2, 3.01]}])
    assert (await put(running, map_id, points=[]))["points"] == []
    assert await running.status("DELETE", f"/maps/{map_id}") == 204
    assert list(running.storage.names("control")) == []


@pytest.mark.parametrize(
    ("body", "field", "words"),
    [
        ({}, "body", "either points or csv"),
        ({"csv": "name,x,y,z\nA,1,2,z\n"}, "csv", "line 2"),
        ({"points": [{"name": "A", "x": 1, "y": 2}]}, "points.0", "all three of one kind"),
        ({"points": [{"name": "A", "x": 1, "y": 2, "z": 3}] * 2}, "body", "each name once"),
        ({"csv": "A,1,2,3", "coordinate_system": "EPSG:4326"}, "coordinate_system", "projected"),
        (
            {
                "points": [{"name": "A", "x": 9e7, "y": 9e7, "z": 3, "position_m": [0, 0, 0]}],
                "coordinate_system": "EPSG:25832",
            },
            "points",
            "whether x is east",
        ),
    ],
)
async def test_what_cannot_be_compared_is_refused(running: RunningService, body: Any, field: str, words: str) -> None:
    map_id = await running.ready_map()
    reply = await running.client.put(f"/maps/{map_id}/control-points", json=body)
    assert (reply.status_code, reply.json()["fields"][0]["field"]) == (422, field), reply.text
    assert words in reply.json()["detail"]


async def test_points_are_set_by_the_owner_and_seen_by_whom_the_map_is_shared_with(
    serve: Serve, tmp_path: Path
) -> None:
    file, scopes = KeyFile(tmp_path), cast(list[Scope], ["read", "localize", "write"])
    ann, bob = (file.make(name, scopes, tenant=name)[1] for name in ("ann", "bob"))
    async with serve() as running:
        map_id = await running.by(ann).ready_map()
        path, body = f"/maps/{map_id}/control-points", {"csv": "A,1,2,3"}
        assert await running.by(bob).status("GET", path) == 404
        await running.by(ann).client.patch(f"/maps/{map_id}", json={"shared_with": ["bob"]})
        assert await running.by(bob).status("GET", path) == 200
        assert await running.by(bob).status("PUT", path, json=body) == 403
        assert await running.by(ann).status("PUT", path, json=body) == 200
