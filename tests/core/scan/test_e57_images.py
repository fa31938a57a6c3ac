"""Images of an E57 file: they colour its points, and come out of it as photos."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from panoloc.core.errors import ScanContentError
from panoloc.core.exports.colmap import FACES, cut_face, turned
from panoloc.core.exports.frames import quaternion_wxyz
from panoloc.core.exports.tour import PlacedPhoto, Tour
from panoloc.core.geometry.pose import Pose
from panoloc.core.scan.e57.__main__ import REFUSED, main
from panoloc.core.scan.reading import read_scan
from tests.core.exports.tours import written
from tests.core.image.picture_files import encoded
from tests.core.painted_box import PaintedBox, rotation_of
from tests.core.scan.e57_files import CARTESIAN, pose_node, structure
from tests.core.scan.scan_files import codes_of

pye57 = pytest.importorskip("pye57")

BOX = PaintedBox(seed=3)
STATIONS = (
    Pose(rotation_of(70.0, 3.0, -2.0), np.array([1.0, 2.0, 1.6])),
    Pose(rotation_of(-140.0), np.array([3.5, 1.5, 1.4])),
)
LARGE = np.array([431_250.25, 5_312_480.5, 412.75])
RED, BLUE = (200, 30, 30), (30, 30, 200)


def without_colors(path: Path, positions: np.ndarray) -> Path:
    """Write points alone as an E57 file, with a pose as stations have it."""
    file = pye57.E57(str(path), mode="w")
    add_points(file, positions)
    file.close()
    return path


def add_points(file: Any, positions: np.ndarray) -> None:
    shift = np.floor(positions.min(axis=0))
    columns = dict(zip(CARTESIAN, (positions - shift).T, strict=True))
    file.write_scan_raw(columns, name="station", rotation=np.array([1.0, 0, 0, 0]), translation=shift)


def survey(folder: Path, positions: np.ndarray, photos: list[tuple[str, Pose, np.ndarray]]) -> Path:
    """Return our own export as E57: a survey without colours, and photos with their poses."""
    placed = []
    for number, (name, pose, colors) in enumerate(photos):
        image = folder / f"{number}.png"
        image.write_bytes(encoded(colors))
        placed.append(PlacedPhoto(name, pose, colors.shape[1], colors.shape[0], image=image))
    scan = without_colors(folder / "points.e57", positions)
    tour = Tour("map_1", tuple(placed), survey=scan)
    return written("e57", tour, folder / "out") / "tour.e57"


def painted_survey(folder: Path, offset: np.ndarray) -> Path:
    photos = [
        (f"pano {number}.png", Pose(pose.rotation, pose.position + offset), BOX.panorama(pose, 512).color)
        for number, pose in enumerate(STATIONS)
    ]
    return survey(folder, BOX.scan(24_000).positions.astype(np.float64) + offset, photos)


def cube_survey(folder: Path, offset: np.ndarray, size: int = 256) -> Path:
    """Write points without colours, and six faces of a cube per station, all of one name."""
    path = folder / "cubes.e57"
    file = pye57.E57(str(path), mode="w")
    add_points(file, BOX.scan(24_000).positions.astype(np.float64) + offset)
    for number, station in enumerate(STATIONS):
        panorama = BOX.panorama(station, 1024).color
        for face in FACES:
            pose = Pose(station.rotation @ turned(face), station.position + offset)
            _add_pinhole(file, f"station {number}.png", pose, cut_face(panorama, size, face))
    file.close()
    return path


def _add_pinhole(file: Any, name: str, pose: Pose, colors: np.ndarray, has_pose: bool = True) -> None:
    """Add a pinhole image of 90 degrees, axes by ASTM E2807: x right, y up, z backward; its pose may be left unsaid."""
    image_file, data, size = file.image_file, np.frombuffer(encoded(colors), np.uint8).copy(), len(colors)
    right_up_back = np.stack([-pose.rotation[:, 1], pose.rotation[:, 2], -pose.rotation[:, 0]], axis=1)
    picture = structure(
        image_file,
        pngImage=pye57.libe57.BlobNode(image_file, len(data)),
        imageWidth=size,
        imageHeight=size,
        focalLength=0.01,
        pixelWidth=0.02 / size,
        pixelHeight=0.02 / size,
        principalPointX=size / 2,
        principalPointY=size / 2,
    )
    posed = {"pose": pose_node(image_file, quaternion_wxyz(right_up_back), pose.position.tolist())} if has_pose else {}
    images = file.root["images2D"]
    images.append(structure(image_file, guid=f"{len(images)}", name=name, pinholeRepresentation=picture, **posed))
    images[len(images) - 1]["pinholeRepresentation"]["pngImage"].write(data, 0, len(data))


@pytest.mark.slow
@pytest.mark.parametrize(("make", "median"), [(painted_survey, 4), (cube_survey, 6)])
def test_points_get_the_colours_of_the_panoramas_or_cube_faces_that_see_them(
    tmp_path: Path, make: Callable[[Path, np.ndarray], Path], median: int
) -> None:
    cloud = read_scan(make(tmp_path, LARGE))
    assert "colored_by_images" in codes_of(cloud)
    assert len(cloud) > 0.97 * 24_000
    at = cloud.positions.astype(np.float64) + cloud.origin_offset - LARGE
    difference = np.abs(cloud.colors.astype(int) - BOX.color_at(at)).max(axis=1)
    assert np.median(difference) <= median
    assert np.mean(difference < 40) > 0.9  # pixels at the edges of pictures show what is beside


@pytest.mark.slow
def test_faces_of_cubes_come_out_with_their_cameras(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "images"
    assert main([str(cube_survey(tmp_path, np.zeros(3), size=64)), str(folder)]) == 0
    assert json.loads(capsys.readouterr().out) == {"num_images": 12, "num_others": 0}
    cameras = json.loads((folder / "cameras.json").read_text())
    assert sorted(cameras) == sorted(file.name for file in folder.glob("*.png"))
    assert len(cameras) == 12
    sizes = {"width_px": 64, "height_px": 64, "cx_px": 32, "cy_px": 32, "fx_px": 32, "fy_px": 32}
    for camera in cameras.values():
        assert camera.pop("model") == "pinhole"
        assert camera == pytest.approx(sizes)


@pytest.mark.slow
def test_what_is_hidden_from_a_panorama_has_the_colour_that_another_one_shows_or_none(tmp_path: Path) -> None:
    """A blue board two metres before a red wall; the second panorama stands between the two."""
    y, z = (each.ravel() for each in np.meshgrid(np.linspace(-3, 3, 301), np.linspace(-3, 3, 301)))
    wall = np.stack([np.full(y.size, 5.0), y, z], axis=1)
    is_board = (np.abs(y) < 1) & (np.abs(z) < 1)
    board = wall[is_board] - np.array([3.0, 0, 0])
    rows, columns = np.meshgrid(np.arange(512), np.arange(1024), indexing="ij")
    azimuth, elevation = np.pi - (columns + 0.5) * np.pi / 512, np.pi / 2 - (rows + 0.5) * np.pi / 512
    across, up = np.tan(azimuth), np.tan(elevation) / np.cos(azimuth)
    sees_board = (np.abs(azimuth) < np.pi / 2) & (np.abs(2 * across) < 1) & (np.abs(2 * up) < 1)
    first = np.where(sees_board[..., None], BLUE, RED).astype(np.uint8)
    photos = [("first.png", Pose(np.eye(3), np.zeros(3)), first)]
    hidden = 5 * 1 / 2 * 0.9  # of the wall, behind the board, half its width

    def found(folder: Path, photos: list[Any]) -> tuple[np.ndarray, np.ndarray]:
        folder.mkdir()
        cloud = read_scan(survey(folder, np.vstack([wall, board]), photos))
        return cloud.positions.astype(np.float64) + cloud.origin_offset, cloud.colors

    at, colors = found(tmp_path / "one", photos)
    behind = (at[:, 0] > 4) & (np.abs(at[:, 1:]) < hidden).all(axis=1)
    assert behind.sum() < 0.02 * (wall[:, 1:] < hidden).all(axis=1).sum()
    second = np.where((np.abs(azimuth) > np.pi / 2)[..., None], BLUE, RED).astype(np.uint8)
    photos.append(("second.png", Pose(np.eye(3), np.array([3.5, 0, 0])), second))
    at, colors = found(tmp_path / "two", photos)
    behind = (at[:, 0] > 4) & (np.abs(at[:, 1:]) < hidden).all(axis=1)
    assert behind.sum() > 1000
    assert np.mean((colors[behind] == RED).all(axis=1)) > 0.98
    on_board = (at[:, 0] < 3) & (np.abs(at[:, 1:]) < 0.9).all(axis=1)
    assert np.mean((colors[on_board] == BLUE).all(axis=1)) > 0.98


def test_without_colours_and_without_panoramas_with_poses_a_scan_is_refused_as_before(tmp_path: Path) -> None:
    positions = BOX.scan(1000).positions.astype(np.float64)
    with pytest.raises(ScanContentError, match="no colour"):
        read_scan(without_colors(tmp_path / "bare.e57", positions))
    image = tmp_path / "pano.png"
    image.write_bytes(b"\x89PNG and nothing that decodes")
    photo = PlacedPhoto("pano.png", STATIONS[0], 16, 8, image=image)
    tour = Tour("map_1", (photo,), survey=without_colors(tmp_path / "points.e57", positions))
    with pytest.raises(ScanContentError, match=r"'pano.png' cannot be read"):
        read_scan(written("e57", tour, tmp_path / "out") / "tour.e57")


def test_images_without_poses_are_named_where_a_scan_has_no_colours(tmp_path: Path) -> None:
    path = tmp_path / "unposed.e57"
    file = pye57.E57(str(path), mode="w")
    add_points(file, BOX.scan(1000).positions.astype(np.float64))
    for number in range(2):
        _add_pinhole(file, f"{number}.png", STATIONS[0], np.zeros((8, 8, 3), np.uint8), has_pose=False)
    file.close()
    with pytest.raises(ScanContentError, match=r"no colour .* and 2 images, but none that is readable and has a pose"):
        read_scan(path)


def test_images_come_out_as_they_went_in_and_stay_as_they_are(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    colors = np.zeros((8, 16, 3), np.uint8)
    names = ("../hall.png", "hall.PNG", "first floor/hall", "")
    photos = [(name or "x.png", STATIONS[0], colors + number) for number, name in enumerate(names)]
    positions = BOX.scan(1000).positions.astype(np.float64)
    # The export names photos by what they are; what comes out has to be named by what it is.
    path = survey(
        tmp_path,
        positions,
        [(name if name.lower().endswith("png") else f"{name}.png", pose, image) for name, pose, image in photos],
    )
    folder = tmp_path / "images"
    assert main([str(path), str(folder)]) == 0
    assert json.loads(capsys.readouterr().out) == {"num_images": 4, "num_others": 0}
    assert sorted(file.name for file in folder.iterdir()) == ["hall-2.png", "hall-3.png", "hall.png", "x.png"]
    assert (folder / "hall.png").read_bytes() == encoded(colors)
    before = {file.name: file.stat().st_mtime_ns for file in folder.iterdir()}
    assert main([str(path), str(folder)]) == 0
    assert {file.name: file.stat().st_mtime_ns for file in folder.iterdir()} == before
    (tmp_path / "none.e57").write_bytes(path.read_bytes()[:-1024])
    assert main([str(tmp_path / "none.e57"), str(folder)]) == REFUSED
    assert "is damaged" in capsys.readouterr().err
