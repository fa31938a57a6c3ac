"""What formats hold, what they leave out, and what they refuse."""

import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import get_args
from xml.etree import ElementTree

import numpy as np
import pygltflib
import pystac
import pytest
from PIL import Image

from panoloc.core.errors import ExportRefusedError
from panoloc.core.exports.formats import EXPORTERS, export, north_of
from panoloc.core.exports.tour import LeftOut, Tour, read_tour
from panoloc.core.geometry.pose import Pose
from panoloc.core.options import ExportFormat
from panoloc.core.scan.ply.writer import write_ply
from panoloc.core.scan.point_cloud import PointCloud
from panoloc.core.scan.reading import read_scan
from tests.core.exports.readers import READERS
from tests.core.exports.tours import GEOREFERENCE, GOLDEN, LARGE, document_of, golden_tour, rotation_of, written
from tests.core.scan.e57_files import add_scan, buffers_of

FORMATS: tuple[ExportFormat, ...] = get_args(ExportFormat)


def test_a_photo_without_a_pose_stands_beside_and_in_no_other_file(tmp_path: Path) -> None:
    for name in FORMATS:
        folder = tmp_path / name
        folder.mkdir()
        tour = replace(golden_tour(folder), left_out=(LeftOut("garden.jpg", "not_localized"),))
        out = written(name, tour, folder / "out")
        assert (out / "unplaced.txt").read_text() == "garden.jpg\tnot_localized\n"
        summary = json.loads((out / "export.json").read_text())
        assert (summary["num_photos"], summary["left_out"][0]["name"]) == (1, "garden.jpg")
        others = [
            path for path in out.rglob("*") if path.is_file() and path.name not in ("unplaced.txt", "export.json")
        ]
        assert others
        assert not any(b"garden" in path.read_bytes() for path in others)


@pytest.mark.parametrize("name", FORMATS)
def test_a_tour_without_photos_is_written_all_the_same(name: ExportFormat, tmp_path: Path) -> None:
    tour = replace(golden_tour(), photos=(), left_out=(LeftOut("garden.jpg", "not_localized"),))
    assert (written(name, tour, tmp_path) / "unplaced.txt").read_text().startswith("garden.jpg")


def test_formats_of_places_on_earth_refuse_a_map_without_a_georeference_and_the_others_do_not() -> None:
    refused = set()
    for name in FORMATS:
        try:
            list(export(name, golden_tour(georeference=None)))
        except ExportRefusedError:
            refused.add(name)
    assert refused == {"arcgis", "stac", "gpano", "geojson"}
    with pytest.raises(ExportRefusedError, match=r"georeference or a coordinate system.*set one of them"):
        list(export("stac", golden_tour(georeference=None)))


def test_every_format_says_which_north_it_means() -> None:
    on_earth = {name for name in FORMATS if north_of(name, golden_tour()) == "true"}
    assert on_earth == {"arcgis", "stac", "gpano", "geojson", "opensfm"}
    assert north_of("opensfm", golden_tour(georeference=None)) == "map"


def test_a_photo_that_is_no_sphere_is_left_out_of_what_holds_spheres_and_kept_where_poses_are_all(
    tmp_path: Path,
) -> None:
    tour = golden_tour(tmp_path)
    tour = replace(tour, photos=(*tour.photos, replace(tour.photos[0], name="phone.jpg", is_sphere=False)))
    for name in FORMATS:
        summary = document_of(name, tour, tmp_path / name)
        assert summary["num_photos"] == (1 if EXPORTERS[name].spheres_only else 2), name
    (node,) = [
        node for node in pygltflib.GLTF2().load(str(tmp_path / "gltf" / "tour.gltf")).nodes if "phone" in node.name
    ]
    assert node.name == "photo:phone.jpg"


@pytest.mark.parametrize(
    ("name", "change", "reason"),
    [
        ("arcgis", {"map_from_camera": replace(GOLDEN, rotation=rotation_of(0, 0, 120))}, "roll is 120 degrees"),
        ("gpano", {"name": "pano.png"}, "JPEG"),
        ("gpano", {"image": None}, "no longer exists"),
        ("e57", {"name": "pano.webp"}, "JPEG and PNG"),
        ("colmap", {"name": "my pano.jpg"}, "space"),
        ("potree", {"name": "my\tpano.jpg"}, "cannot be printed"),
    ],
)
def test_what_a_format_cannot_hold_is_left_out_with_its_reason(
    name: ExportFormat, change: dict[str, object], reason: str, tmp_path: Path
) -> None:
    tour = golden_tour(tmp_path)
    tour = replace(tour, photos=(replace(tour.photos[0], **change),))  # type: ignore[arg-type]
    summary = document_of(name, tour, tmp_path / "out")
    assert summary["num_photos"] == 0
    assert reason in summary["left_out"][0]["reason"]


@pytest.mark.slow
def test_photos_whose_names_differ_little_stay_different_photos(tmp_path: Path) -> None:
    tour = golden_tour(tmp_path)
    names = ("a b.jpg", "a_b.jpg", "a_b.png", "a+b.jpg", "hall/a_b.jpg", "A_B.jpg")
    tour = replace(tour, photos=tuple(replace(tour.photos[0], name=name) for name in names))
    rig = written("colmap-rig", tour, tmp_path / "rig")
    kept = [line.split("; ")[1] for line in (rig / "names.csv").read_text().splitlines()[1:]]
    assert kept == list(names)
    for face in ("front", "down"):
        cut = {str(path.relative_to(rig / "images" / face)) for path in (rig / "images" / face).rglob("*.jpg")}
        assert cut == {line.split("; ")[0] for line in (rig / "names.csv").read_text().splitlines()[1:]}
        assert len(cut) == len(names)
    images = document_of("stac", tour, tmp_path / "stac", "items.json")["features"]
    assert len({item["id"].lower() for item in images}) == len(names)
    assert [item["assets"]["image"]["href"] for item in images] == list(names)
    cameras = ElementTree.parse(written("metashape", tour, tmp_path / "metashape") / "cameras.xml").findall(".//camera")
    assert len({camera.attrib["label"] for camera in cameras}) == len(names)


def test_without_all_times_photos_are_numbered_in_their_order() -> None:
    (photo,) = golden_tour().photos
    tour = Tour("map_1", (photo, replace(photo, name="b.jpg", time_unix_s=None)))
    assert tour.times_unix_s == [0.0, 1.0]
    (table, *_) = export("potree", tour)
    assert isinstance(table.content, bytes)
    assert [line.split("\t")[1] for line in table.content.decode().splitlines()] == ["time", "0", "1"]


def test_a_photo_without_a_time_has_none_but_in_stac_which_takes_when_it_was_placed(tmp_path: Path) -> None:
    (photo,) = golden_tour().photos
    tour = replace(golden_tour(), photos=(replace(photo, time_unix_s=None),), created_unix_s=86400.0)
    heading, row = (written("arcgis", tour, tmp_path) / "oriented_imagery.csv").read_text().splitlines()
    assert dict(zip(heading.split(","), row.split(","), strict=True))["AcquisitionDate"] == ""
    (feature,) = document_of("geojson", tour, tmp_path, "photos.geojson")["features"]
    assert feature["properties"]["time"] is None
    (item,) = document_of("stac", tour, tmp_path, "items.json")["features"]
    assert item["properties"]["datetime"] == "1970-01-02T00:00:00.000Z"


@pytest.mark.parametrize(
    ("offset", "expected"),
    [("+02:00", "2025-06-26T12:03:18.250Z"), ("   :  ", "2025-06-26T14:03:18.250"), ("", "2025-06-26T14:03:18.250")],
)
def test_a_clock_without_an_offset_is_not_called_universal_time(offset: str, expected: str, tmp_path: Path) -> None:
    exif = Image.Exif()
    exif.get_ifd(0x8769).update({0x9003: "2025:06:26 14:03:18", 0x9291: "25"})
    if offset:
        exif.get_ifd(0x8769)[0x9011] = offset
    Image.new("RGB", (64, 32)).save(tmp_path / "a.jpg", exif=exif)
    pose = {"frame": "ros", "position_m": [1, 2, 3], "quaternion_xyzw": [0, 0, 0, 1], "camera_model": "equirectangular"}
    document = {
        "name": "map_1",
        "created_unix_s": 0,
        "coordinate_system": None,
        "geoid_undulation_m": None,
        "scan": None,
        "survey": None,
        "floor_levels_m": [],
        "title": "Office",
        "page": None,
    }
    document |= {
        "georeference": asdict(GEOREFERENCE),
        "left_out": [],
        "photos": [{"name": "a.jpg", "image": str(tmp_path / "a.jpg"), **pose}],
    }
    (tmp_path / "tour.json").write_text(json.dumps(document))
    tour = read_tour(tmp_path / "tour.json", tmp_path)
    (feature,) = document_of("geojson", tour, tmp_path, "photos.geojson")["features"]
    assert feature["properties"]["time"] == expected
    assert expected in (written("arcgis", tour, tmp_path) / "oriented_imagery.csv").read_text().splitlines()[1].split(
        ","
    )
    (item,) = document_of("stac", tour, tmp_path, "items.json")["features"]
    times = [item["properties"].get(name) for name in ("datetime", "start_datetime", "end_datetime")]
    interval = [None, "2025-06-26T00:03:18.250Z", "2025-06-27T02:03:18.250Z"]  # from 14 hours ahead of UTC to 12 behind
    assert times == ([expected, None, None] if expected.endswith("Z") else interval)
    assert pystac.Item.from_dict({**item, "stac_extensions": []}).validate()


@pytest.mark.slow
def test_items_of_stac_are_valid_by_the_schema_of_stac_itself(tmp_path: Path) -> None:
    (item,) = document_of("stac", golden_tour(), tmp_path, "items.json")["features"]
    core_only = {**item, "stac_extensions": []}  # those of extensions are fetched from the network
    assert pystac.Item.from_dict(core_only).validate()
    properties = item["properties"]
    assert properties["pano:projection_type"] == "equirectangular"
    assert 0 <= properties["pano:yaw"] < 360
    with pytest.raises(pystac.STACValidationError):
        pystac.Item.from_dict({**core_only, "geometry": {"type": "Point", "coordinates": "here"}}).validate()


def cloud_of(offset: np.ndarray) -> PointCloud:
    random = np.random.default_rng(3)
    positions = random.uniform(0, 6, size=(500, 3)).astype(np.float32)
    return PointCloud(positions, random.integers(0, 256, size=(500, 3)).astype(np.uint8), offset)


@pytest.mark.parametrize("offset", [np.zeros(3), LARGE])
def test_the_points_of_the_map_go_with_photos_that_stand_in_them(offset: np.ndarray, tmp_path: Path) -> None:
    write_ply(tmp_path / "points.ply", cloud_of(offset))
    tour = replace(golden_tour(tmp_path), scan=tmp_path / "points.ply")
    expected = read_scan(tmp_path / "points.ply")
    order = np.lexsort(expected.positions.T)
    found = read_scan(written("e57", tour, tmp_path / "e57") / "tour.e57")
    again = np.lexsort(found.positions.T)
    positions = found.positions[again].astype(np.float64) + found.origin_offset
    np.testing.assert_allclose(positions, expected.positions[order] + expected.origin_offset, atol=1e-6)
    np.testing.assert_array_equal(found.colors[again], expected.colors[order])
    lines = (written("colmap", tour, tmp_path / "colmap") / "points3D.txt").read_text().splitlines()[1:]
    rows = np.array([[float(value) for value in line.split(" ")] for line in lines])
    np.testing.assert_allclose(rows[:, 1:4], expected.positions + expected.origin_offset, atol=1e-6)
    np.testing.assert_array_equal(rows[:, 4:7], expected.colors)
    folder = written("nerfstudio", tour, tmp_path / "nerfstudio")
    named = json.loads((folder / "transforms.json").read_text())["ply_file_path"]
    assert (folder / named).read_bytes() == (tmp_path / "points.ply").read_bytes()


@pytest.mark.parametrize("name", ["potree", "psv", "pannellum"])
def test_a_tour_for_the_web_has_its_photos_and_a_page(name: ExportFormat, tmp_path: Path) -> None:
    tour = golden_tour(tmp_path)
    photos = tuple(replace(tour.photos[0], name=each) for each in ("pano.jpg", "hall/50% #2.jpg"))
    folder = written(name, replace(tour, name="</title>", photos=photos), tmp_path / name)
    for photo in photos:
        assert (folder / photo.name).read_bytes() == (tmp_path / "pano.jpg").read_bytes()
    page = (folder / "index.html").read_text()
    assert page.count("</title>") == 1
    assert "http.server" in page


def test_links_of_a_tour_follow_the_scan_and_point_at_the_other_photo(tmp_path: Path) -> None:
    """Three photos two metres apart along y; a wall stands between the second and the third, and one link leads through."""
    tour = golden_tour(tmp_path)
    photos = tuple(
        replace(
            tour.photos[0], name=f"{number}.jpg", map_from_camera=Pose(GOLDEN.rotation, LARGE + np.array([0, y, z]))
        )
        for number, (y, z) in enumerate([(0, 0), (2, 0), (6, 1), (7, 0)])
    )
    x, z = np.mgrid[-3:3:0.04, -3:3:0.04].reshape(2, -1)
    wall = np.stack([x, np.full_like(x, 4), z], axis=1).astype(np.float32)
    write_ply(tmp_path / "points.ply", PointCloud(wall, np.full(wall.shape, 99, np.uint8), LARGE))
    tour = replace(tour, photos=photos, scan=tmp_path / "points.ply")
    nodes = document_of("psv", tour, tmp_path / "psv", "tour.json")["virtualTour"]["nodes"]
    assert [[int(link["nodeId"]) for link in node["links"]] for node in nodes] == [[1], [0, 2], [3, 1], [2]]
    assert nodes[1]["links"][0]["position"] == {"yaw": "180deg", "pitch": "0deg"}
    assert float(nodes[2]["links"][0]["position"]["pitch"].removesuffix("deg")) == pytest.approx(-45)
    scenes = document_of("pannellum", tour, tmp_path / "pannellum", "pannellum.json")["scenes"]
    assert [[spot["sceneId"] for spot in scene["hotSpots"]] for scene in scenes.values()] == [
        [f"{other}.jpg" for other in linked] for linked in ([1], [0, 2], [3, 1], [2])
    ]
    for scene in scenes.values():
        assert all(-180 <= spot["yaw"] <= 180 for spot in scene["hotSpots"])
    spot = scenes["0.jpg"]["hotSpots"][0]
    assert (spot["yaw"] + scenes["0.jpg"]["northOffset"]) % 360 == pytest.approx(0)


def read_raw(path: Path) -> list[dict[str, np.ndarray]]:
    """Return the fields of every scan, and its pose as (w, x, y, z, tx, ty, tz)."""
    from pye57 import E57

    file, scans = E57(str(path)), []
    for number in range(file.scan_count):
        header = file.get_header(number)
        fields = file.read_scan_raw(number)
        scans.append({**fields, "pose": np.concatenate([header.rotation, header.translation])})
    file.close()
    return scans


def test_the_scans_of_an_e57_come_out_as_they_went_in_with_photos_beside_them(tmp_path: Path) -> None:
    from pye57 import E57

    random = np.random.default_rng(5)
    file = E57(str(tmp_path / "stations.e57"), mode="w")
    for station in range(3):
        columns: dict[str, np.ndarray] = {
            name: random.normal(size=1000) * 10 for name in ("cartesianX", "cartesianY", "cartesianZ", "intensity")
        }
        columns |= {f"color{name}": random.integers(0, 256, 1000).astype(np.uint8) for name in ("Red", "Green", "Blue")}
        columns |= {name: np.arange(1000) for name in ("rowIndex", "columnIndex")}
        turned = np.array([np.cos(0.3), 0, 0, np.sin(0.3)])
        file.write_scan_raw(columns, name=f"station {station}", rotation=turned, translation=LARGE + station)
    file.close()
    before = read_raw(tmp_path / "stations.e57")
    tour = replace(golden_tour(tmp_path), survey=tmp_path / "stations.e57")
    out = written("e57", tour, tmp_path / "out") / "tour.e57"
    after = read_raw(out)
    assert len(after) == len(before) == 3
    for old, new in zip(before, after, strict=True):
        assert old.keys() == new.keys()
        for name, column in old.items():
            np.testing.assert_allclose(new[name], column, rtol=0, atol=0, err_msg=name)
    pose = READERS["e57"](tmp_path / "out")["pano.jpg"]
    np.testing.assert_allclose(pose.matrix, GOLDEN.matrix, atol=1e-12)


def test_fields_of_every_kind_of_node_survive(tmp_path: Path) -> None:
    from pye57 import E57, libe57

    file = E57(str(tmp_path / "fields.e57"), mode="w")
    image_file = file.image_file
    image_file.extensionsAdd("nor", "http://www.libe57.org/E57_NOR_surface_normals.txt")
    kinds = {
        "sphericalAzimuth": libe57.ScaledIntegerNode(image_file, 0, -4_000_000, 4_000_000, 1e-6, 0.0),
        "timeStamp": libe57.IntegerNode(image_file, 0, 0, 2**53),
        "nor:normalX": libe57.FloatNode(image_file, 0.0, libe57.E57_SINGLE, -1.0, 1.0),
    }
    columns = {
        "sphericalRange": np.linspace(0.1, 9, 7),
        "sphericalAzimuth": np.arange(-3, 4) * 0.123456,
        "timeStamp": 2.0**53 - np.arange(7),
        "nor:normalX": np.linspace(-1, 1, 7),
    }
    add_scan(file, columns, kinds, guid="{one}")
    file.close()
    tour = replace(golden_tour(tmp_path), survey=tmp_path / "fields.e57")
    out = E57(str(written("e57", tour, tmp_path / "out") / "tour.e57"))
    copied = out.root["data3D"][0]
    assert copied["guid"].value() == "{one}"
    found = {field: np.zeros(7) for field in columns}
    reader = copied["points"].reader(buffers_of(out.image_file, found))
    assert reader.read() == 7
    for field, column in columns.items():
        atol = 6e-8 if field.startswith("nor") else 0
        np.testing.assert_allclose(found[field], column, rtol=0, atol=atol, err_msg=field)
    reader.close()
    out.close()


@pytest.mark.parametrize("name", ["gpano", "e57"])
def test_a_photo_that_is_not_what_its_name_says_is_left_out_and_not_spoiled(name: ExportFormat, tmp_path: Path) -> None:
    golden = golden_tour(tmp_path)
    Image.open(tmp_path / "pano.jpg").save(tmp_path / "called.jpg", "PNG")
    tour = replace(golden, photos=(replace(golden.photos[0], name="called.jpg", image=tmp_path / "called.jpg"),))
    folder = written(name, tour, tmp_path / name)
    assert not (folder / "called.jpg").exists()
    assert (
        folder / "unplaced.txt"
    ).read_text() == "called.jpg\tits content does not match .jpg; rename it to match its content\n"
