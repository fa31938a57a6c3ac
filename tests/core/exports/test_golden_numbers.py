"""Each format writes the golden pose as its specification has it; numbers worked out elsewhere."""

import csv
import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from panoloc.core.earth.geopose import earth_pose
from panoloc.core.exports.robots import RADIUS_PER_SIGMA
from panoloc.core.geometry.pose import quaternion_of
from panoloc.core.options import ExportFormat
from tests.core.exports.readers import READERS
from tests.core.exports.tours import (
    GEOREFERENCE,
    GOLDEN,
    HEIGHT,
    PIXEL,
    POINT,
    WIDTH,
    document_of,
    golden_tour,
    jpeg,
    written,
)

QUATERNION_XYZW = [-0.010196774, 0.113835941, 0.435420574, 0.892942511]
CAM_FROM_WORLD = [0.602165185, 0.726197900, -0.280580552, 0.176941385, -2.396964088, 1.507864142, 1.534082426]
GL_ROWS: list[list[float]] = [
    [0.779932600, 0.194418132, -0.594900605, 1.25],
    [-0.620609899, 0.117343287, -0.775289563, -2.5],
    [-0.080922756, 0.973874809, 0.212177672, 1.6],
    [0, 0, 0, 1],
]


def near(expected: Any) -> Any:
    return pytest.approx(expected, abs=2e-9)


def files(name: ExportFormat, folder: Path) -> Path:
    return written(name, golden_tour(folder), folder / "out")


def document(name: ExportFormat, file: str, folder: Path) -> Any:
    return document_of(name, golden_tour(folder), folder / "out", file)


def test_the_golden_pose_is_the_one_of_the_specification() -> None:
    assert GOLDEN.quaternion_xyzw.tolist() == near(QUATERNION_XYZW)
    assert GOLDEN.inverse().rotation @ (POINT - GOLDEN.position) == near([4.582885572, -0.061695034, -0.125910922])


def test_potree_has_a_header_and_a_line_of_eight_columns(tmp_path: Path) -> None:
    lines = (files("potree", tmp_path) / "coordinates.txt").read_text().splitlines()
    assert lines == [
        "filename\ttime\tlong\tlat\talt\tcourse\tpitch\troll",
        "pano.jpg\t1750939398.316\t1.25\t-2.5\t1.6\t37.5\t-12.25\t4.75",
    ]


def test_navvis_has_its_header_its_names_and_w_first(tmp_path: Path) -> None:
    folder = files("navvis", tmp_path)
    assert (folder / "pano-poses.csv").read_text().splitlines() == [
        "# pano poses v1.0: ID; filename; timestamp; pano_pos_x; pano_pos_y; pano_pos_z; "
        "pano_ori_w; pano_ori_x; pano_ori_y; pano_ori_z",
        "0; 00000-pano.jpg; 1750939398.316000; 1.250000; -2.500000; 1.600000; 0.892943; -0.010197; 0.113836; 0.435421",
    ]
    assert (folder / "00000-pano.jpg").read_bytes() == (tmp_path / "pano.jpg").read_bytes()


def test_colmap_has_an_equirectangular_camera_and_two_lines_per_image(tmp_path: Path) -> None:
    folder = files("colmap", tmp_path)
    assert (folder / "cameras.txt").read_text().splitlines()[1:] == ["1 EQUIRECTANGULAR 2048 1024 2048 1024"]
    image, empty = (folder / "images.txt").read_text().split("\n")[1:3]
    number, *pose, camera, name = image.split(" ")
    assert (number, camera, name, empty) == ("1", "1", "pano.jpg", "")
    assert list(map(float, pose)) == near(CAM_FROM_WORLD)


def test_opensfm_has_a_rotation_vector_and_the_origin_as_reference(tmp_path: Path) -> None:
    folder = files("opensfm", tmp_path)
    (reconstruction,) = json.loads((folder / "reconstruction.json").read_text())
    shot = reconstruction["shots"]["pano.jpg"]
    assert shot["rotation"] == near([1.682004875, -0.649874996, 0.409828054])
    assert shot["translation"] == near(CAM_FROM_WORLD[4:])
    camera = reconstruction["cameras"][shot["camera"]]
    assert camera == {"projection_type": "spherical", "width": 2048, "height": 1024}
    origin = {"latitude": 47.7, "longitude": -122.3, "altitude": 11.5}
    assert json.loads((folder / "reference_lla.json").read_text()) == origin


def test_nerfstudio_has_the_golden_rows_and_forbids_turning(tmp_path: Path) -> None:
    found = document("nerfstudio", "transforms.json", tmp_path)
    (frame,) = found.pop("frames")
    np.testing.assert_allclose(frame["transform_matrix"], GL_ROWS, atol=2e-9)
    assert found == {
        "camera_model": "EQUIRECTANGULAR",
        "orientation_override": "none",
        "applied_transform": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]],
        "w": 2048,
        "h": 1024,
        "fl_x": 1024,
        "fl_y": 1024,
        "cx": 1024,
        "cy": 512,
    }


def test_stac_has_the_last_test_vector_of_its_extension(tmp_path: Path) -> None:
    (item,) = document("stac", "items.json", tmp_path)["features"]
    properties = item["properties"]
    angles = [properties[f"pano:{name}"] for name in ("yaw", "pitch", "roll")]
    # The axes of east and north at the camera, three metres from the origin, are turned by 0.00003 degrees.
    assert angles == pytest.approx([37.5, -12.25, 4.75], abs=5e-5)
    rows = [0.7799326, -0.620609899, -0.080922756, 0.194418132, 0.117343287, 0.973874809]
    rows += [-0.594900605, -0.775289563, 0.212177672]
    assert properties["pers:rotation_matrix"] == pytest.approx(rows, abs=1e-6)


def test_the_place_on_earth_is_that_of_geopose() -> None:
    found = earth_pose(GEOREFERENCE, GOLDEN)
    at = [found.latitude_deg, found.longitude_deg, found.height_m]
    assert at == pytest.approx([47.699977515, -122.299983346, 13.100000612], abs=1e-9)
    turned = [-0.010196979, 0.113835940, 0.435420455, 0.892942567]
    assert quaternion_of(found.enu_from_camera).tolist() == near(turned)


def test_geojson_and_stac_have_longitude_first(tmp_path: Path) -> None:
    at = [-122.299983346, 47.699977515, 13.100000612]
    for name, file in (("geojson", "photos.geojson"), ("stac", "items.json")):
        (feature,) = document(name, file, tmp_path)["features"]  # type: ignore[arg-type]
        assert feature["geometry"] == {"type": "Point", "coordinates": pytest.approx(at, abs=1e-9)}


def test_arcgis_counts_its_pitch_from_straight_down(tmp_path: Path) -> None:
    (row,) = csv.DictReader((files("arcgis", tmp_path) / "oriented_imagery.csv").read_text().splitlines())
    angles = [float(row[f"Camera{name}"]) for name in ("Heading", "Pitch", "Roll")]
    assert angles == pytest.approx([37.5, 77.75, 4.75], abs=5e-5)
    assert [float(row[axis]) for axis in "XYZ"] == pytest.approx([-122.299983346, 47.699977515, 13.100000612], abs=1e-9)
    fields = [row[name] for name in ("SRS", "HorizontalFieldOfView", "VerticalFieldOfView", "OrientedImageryType")]
    assert fields == ["4326", "360", "180", "360"]


def test_gpano_has_the_golden_angles_and_all_six_sizes(tmp_path: Path) -> None:
    with Image.open(files("gpano", tmp_path) / "pano.jpg") as image:
        fields = dict(re.findall(r'GPano:(\w+)="([^"]*)"', image.info["xmp"].decode()))
    angles = [float(fields[f"Pose{name}Degrees"]) for name in ("Heading", "Pitch", "Roll")]
    assert angles == pytest.approx([37.5, -12.25, 4.75], abs=5e-5)
    sizes = [fields[f"FullPano{side}Pixels"] for side in ("Width", "Height")]
    sizes += [fields[f"CroppedAreaImage{side}Pixels"] for side in ("Width", "Height")]
    sizes += [fields[f"CroppedArea{side}Pixels"] for side in ("Left", "Top")]
    assert sizes == ["2048", "1024", "2048", "1024", "0", "0"]
    assert (fields["ProjectionType"], fields["UsePanoramaViewer"]) == ("equirectangular", "True")


def test_gltf_has_y_up(tmp_path: Path) -> None:
    (node,) = document("gltf", "tour.gltf", tmp_path)["nodes"]
    assert node["name"] == "panorama:pano.jpg"
    assert node["translation"] == near([1.25, 1.6, 2.5])
    assert node["rotation"] == near([-0.087704374, -0.323516864, -0.073283958, 0.939294545])


def test_photo_sphere_viewer_turns_its_sphere_back(tmp_path: Path) -> None:
    found = document("psv", "tour.json", tmp_path)
    (node,) = found["virtualTour"]["nodes"]
    assert node["sphereCorrection"] == {"pan": "-37.5deg", "tilt": "12.25deg", "roll": "4.75deg"}
    pose = {name: node["panoData"][f"pose{name}"] for name in ("Heading", "Pitch", "Roll")}
    assert pose == {"Heading": 0, "Pitch": 0, "Roll": 0}  # else the viewer adds those of GPano


def test_pannellum_has_its_own_order_of_turns(tmp_path: Path) -> None:
    scene = document("pannellum", "pannellum.json", tmp_path)["scenes"]["pano.jpg"]
    found = [scene["northOffset"], scene["horizonPitch"], scene["horizonRoll"]]
    assert found == pytest.approx([38.510055, -12.290936, 4.641608], abs=1e-6)


def test_metashape_has_sixteen_numbers_of_a_camera_that_looks_along_z(tmp_path: Path) -> None:
    (pose,) = READERS["metashape"](files("metashape", tmp_path)).values()
    text = (tmp_path / "out" / "cameras.xml").read_text()
    numbers = [float(value) for value in text.split("<transform>")[3].split("<")[0].split()]
    r = GOLDEN.rotation
    assert numbers[:4] == near([-r[0, 1], -r[0, 2], r[0, 0], 1.25])
    assert numbers[12:] == [0, 0, 0, 1]
    assert pose.position.tolist() == near([1.25, -2.5, 1.6])
    assert '<resolution width="2048" height="1024" />' in text


def test_e57_has_w_first_and_pixels_in_radians(tmp_path: Path) -> None:
    from pye57 import E57

    file = E57(str(files("e57", tmp_path) / "tour.e57"))
    image = file.root["images2D"][0]
    rotation = [image["pose"]["rotation"][name].value() for name in "wxyz"]
    assert rotation == near([QUATERNION_XYZW[3], *QUATERNION_XYZW[:3]])
    assert [image["pose"]["translation"][name].value() for name in "xyz"] == [1.25, -2.5, 1.6]
    sphere = image["sphericalRepresentation"]
    sizes = [sphere[name].value() for name in ("imageWidth", "imageHeight", "pixelWidth", "pixelHeight")]
    assert sizes == [2048, 1024, 2 * math.pi / 2048, math.pi / 1024]
    assert not image.isDefined("associatedData3DGuid")
    blob = sphere["jpegImage"]
    data = np.zeros(blob.byteCount(), np.uint8)
    blob.read(data, 0, len(data))
    assert data.tobytes() == jpeg()
    # A point of the map, by the standard's own formula.
    x, y, z = GOLDEN.inverse().rotation @ (POINT - GOLDEN.position)
    column = WIDTH / 2 - math.atan2(y, x) / sizes[2]
    row = HEIGHT / 2 - math.atan2(z, math.hypot(x, y)) / sizes[3]
    assert (column, row) == pytest.approx(PIXEL, abs=1e-6)
    file.close()


def test_ros_has_variances_of_its_radii_and_the_time(tmp_path: Path) -> None:
    (item,) = document("ros", "poses.json", tmp_path)
    header, stamped = item["message"]["header"], item["message"]["pose"]
    assert header == {"stamp": {"sec": 1750939398, "nanosec": 316000000}, "frame_id": "map"}
    assert list(stamped["pose"]["orientation"].values()) == near(QUATERNION_XYZW)
    covariance = np.array(stamped["covariance"]).reshape(6, 6)
    radians = math.radians(0.3)
    np.testing.assert_allclose(np.diag(covariance) * 1.872**2, [0.02**2] * 3 + [radians**2] * 3)
    assert np.count_nonzero(covariance) == 6
    geographic = json.loads((tmp_path / "out" / "geo_poses.json").read_text())[0]["message"]["pose"]
    assert geographic["position"] == {
        "latitude": pytest.approx(47.699977515, abs=1e-9),
        "longitude": pytest.approx(-122.299983346, abs=1e-9),
        "altitude": pytest.approx(13.100000612, abs=1e-9),
    }


def test_a_sphere_of_the_radius_of_ros_holds_what_it_should() -> None:
    drawn = np.random.default_rng(0).normal(size=(200_000, 3))
    inside = np.linalg.norm(drawn, axis=1) < RADIUS_PER_SIGMA
    assert inside.mean() == pytest.approx(0.68, abs=0.005)


def test_tum_has_the_quaternion_with_w_last(tmp_path: Path) -> None:
    comment, line = (files("tum", tmp_path) / "poses.tum").read_text().splitlines()
    assert comment.startswith("#")
    assert [float(value) for value in line.split(" ")] == near([1750939398.316, 1.25, -2.5, 1.6, *QUATERNION_XYZW])
