"""Frames with poses out of a `transforms.json`: one query of all of them."""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from panoloc.core.geometry.pose import FRAMES, Pose
from panoloc.core.options import MAX_IMAGES, Frame
from panoloc.service.cli.transforms import TransformsError, read_transforms
from panoloc.service.http.schemas.queries import LocalizeOptions
from tests.service.cli.commands import Panoloc
from tests.service.cli.fake_service import FakeService, answer_with

# A camera as nerfstudio writes it, and what the same pose is with x forward, y left, z up.
GL_ROWS = [
    [0.779932600, 0.194418132, -0.594900605, 1.25],
    [-0.620609899, 0.117343287, -0.775289563, -2.5],
    [-0.080922756, 0.973874809, 0.212177672, 1.6],
    [0.0, 0.0, 0.0, 1.0],
]
KNOWN = Pose.from_frame((1.25, -2.5, 1.6), (-0.010196774, 0.113835941, 0.435420574, 0.892942511), "ros")
PINHOLE = {"camera_model": "PINHOLE", "w": 640, "h": 480, "fl_x": 500.0, "fl_y": 501.0, "cx": 320.0, "cy": 241.0}


def image(number: int) -> bytes:
    """Return what begins as a JPEG does: no more of an image is looked at before it is sent."""
    return b"\xff\xd8\xff image %d" % number


def write(folder: Path, document: Any, num_images: int = 1) -> Path:
    """Write the file, and the images that its frames name."""
    folder.mkdir(exist_ok=True)
    for number in range(num_images):
        (folder / f"{number}.jpg").write_bytes(image(number))
    file = folder / "transforms.json"
    file.write_text(json.dumps(document))
    return file


def one_frame(**fields: Any) -> dict[str, Any]:
    return {**PINHOLE, "frames": [{"file_path": "0.jpg", "transform_matrix": GL_ROWS, **fields}]}


def camera_of(folder: Path, document: Any, frame: Frame = "ros") -> dict[str, Any]:
    (found,) = read_transforms(write(folder, document), frame)
    return found.camera


@pytest.mark.parametrize("frame", FRAMES)
def test_a_known_pose_is_sent_in_the_axes_of_each_frame(tmp_path: Path, frame: Frame) -> None:
    sent = camera_of(tmp_path, one_frame(), frame)["session_from_camera"]
    expected = KNOWN.in_frame(frame)
    assert list(sent["position_m"].values()) == pytest.approx(expected.position.tolist())
    quaternion = np.array(list(sent["quaternion"].values()))
    assert abs(quaternion @ expected.quaternion_xyzw) == pytest.approx(1, abs=1e-8)


def test_positions_that_a_tool_has_scaled_are_sent_in_metres(tmp_path: Path) -> None:
    rows = [[*row[:3], 0.25 * row[3]] for row in GL_ROWS[:3]]
    sent = camera_of(tmp_path, {**one_frame(transform_matrix=rows), "applied_scale": 0.25})["session_from_camera"]
    assert list(sent["position_m"].values()) == pytest.approx(KNOWN.position.tolist())


@pytest.mark.parametrize("scale", [0, -1.0, "2", None, True, float("inf")])
def test_a_scale_that_is_none_is_named(scale: Any, tmp_path: Path) -> None:
    with pytest.raises(TransformsError, match="applied_scale: expected a positive number"):
        camera_of(tmp_path, {**one_frame(), "applied_scale": scale})


@pytest.mark.parametrize("seed", range(8))
def test_any_orientation_is_sent_right_half_turns_included(tmp_path: Path, seed: int) -> None:
    half_turns = [(1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1)]
    drawn = np.random.default_rng(seed).normal(size=4)
    quaternion = half_turns[seed] if seed < 4 else (drawn / np.linalg.norm(drawn)).tolist()
    pose = Pose.from_frame((1.0, 2.0, 3.0), quaternion, "ros")
    # Camera axes right, up, backward; the world keeps z up.
    rows = pose.matrix @ np.array([[0.0, 0, -1, 0], [-1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    sent = camera_of(tmp_path, one_frame(transform_matrix=rows.tolist()))["session_from_camera"]
    assert abs(np.array(list(sent["quaternion"].values())) @ quaternion) == pytest.approx(1, abs=1e-8)
    assert list(sent["position_m"].values()) == [1, 2, 3]


@pytest.mark.parametrize(
    ("fields", "camera"),
    [
        ({}, {"model": "pinhole", "fx_px": 500.0, "fy_px": 501.0, "cx_px": 320.0, "cy_px": 241.0}),
        ({"fl_x": 400.0}, {"fx_px": 400.0}),
        ({"camera_model": "OPENCV", "k1": 0.1, "p2": -0.2}, {"model": "opencv", "distortion": [0.1, 0.0, 0.0, -0.2, 0.0]}),
        ({"camera_model": "OPENCV_FISHEYE", "k4": 0.4}, {"model": "opencv_fisheye", "distortion": [0.0, 0.0, 0.0, 0.4]}),
        ({"camera_model": "EQUIRECTANGULAR"}, {"model": "equirectangular"}),
        ({"camera_model": None, "k2": 0.1}, {"model": "opencv", "distortion": [0.0, 0.1, 0.0, 0.0, 0.0]}),
        ({"camera_model": None}, {"model": "pinhole"}),
        ({"camera_model": None, "is_fisheye": True}, {"model": "opencv_fisheye"}),
        ({"fl_x": None, "camera_angle_x": 1.2}, {"model": "pinhole", "hfov_deg": pytest.approx(68.7549)}),
    ],
)  # fmt: skip
def test_the_lens_is_that_of_the_frame_or_else_of_the_file(
    tmp_path: Path, fields: dict[str, Any], camera: dict[str, Any]
) -> None:
    found = camera_of(tmp_path, one_frame(**fields))
    assert {name: found[name] for name in camera} == camera
    LocalizeOptions.model_validate({"cameras": [found]})


@pytest.mark.parametrize(
    ("document", "says"),
    [
        ([], "expected `frames`"),
        ({"frames": []}, "expected `frames`"),
        (one_frame(camera_model="SIMPLE_RADIAL"), "camera_model: expected one of OPENCV"),
        (one_frame(k1=0.1), "k1: expected coefficients of pinhole (none)"),
        (one_frame(camera_model="OPENCV", k4=0.1), "k4: expected coefficients of opencv (k1 k2 p1 p2 k3)"),
        (one_frame(w="640"), "w: expected a number, got '640'"),
        (one_frame(fl_x=float("nan")), "fl_x: expected a number, got nan"),
        ({"frames": [{"file_path": "0.jpg", "transform_matrix": GL_ROWS}]}, "w: expected a number, got None"),
        (one_frame(file_path="missing.jpg"), "missing.jpg; put the file into the folder of its images"),
        (one_frame(file_path=3), "file_path: expected the name"),
        (one_frame(transform_matrix=[[1, 0], [0, 1]]), "transform_matrix: expected 4 x 4 numbers"),
        (one_frame(transform_matrix=None), "transform_matrix: expected 4 x 4 numbers"),
        (one_frame(transform_matrix=(2 * np.eye(4)).tolist()), "remove the scale"),
        (one_frame(transform_matrix=np.diag([1.0, 1, -1, 1]).tolist()), "scales or mirrors"),
        (one_frame(transform_matrix=np.full((4, 4), np.nan).tolist()), "finite numbers"),
    ],
)
def test_what_a_file_lacks_is_said_with_its_place(tmp_path: Path, document: Any, says: str) -> None:
    with pytest.raises(TransformsError) as caught:
        read_transforms(write(tmp_path, document), "ros")
    assert says in str(caught.value)
    assert "transforms.json" in str(caught.value)


def test_a_folder_without_the_file_is_named_in_words(tmp_path: Path) -> None:
    with pytest.raises(TransformsError) as caught:
        read_transforms(tmp_path, "ros")
    assert str(caught.value).endswith(f"{tmp_path / 'transforms.json'}: No such file or directory")
    assert "Errno" not in str(caught.value)


def walk(num_images: int) -> dict[str, Any]:
    return {**PINHOLE, "frames": [{"file_path": f"{n}.jpg", "transform_matrix": GL_ROWS} for n in range(num_images)]}


@pytest.mark.parametrize("given", ["folder", "file"])
def test_a_session_is_one_query_of_all_its_frames(
    panoloc: Panoloc, fake: FakeService, tmp_path: Path, given: str
) -> None:
    file = write(tmp_path / "walk", walk(3), num_images=3)
    path = file if given == "file" else file.parent
    done = panoloc("localize", "--session", path, "--map", "map_1", "--frame", "webxr", "--up-known")
    assert done.code == 0, done.err
    assert fake.requests == [("POST", "/localize")]
    assert fake.parts["image"] == [image(number) for number in range(3)]
    options = LocalizeOptions.model_validate_json(fake.parts["options"][0])
    assert (len(options.cameras or ()), options.frame) == (3, "webxr")
    assert options.session is not None
    assert options.session.up == "known"


def test_of_many_frames_as_many_are_sent_as_a_query_takes_and_that_is_said(
    panoloc: Panoloc, fake: FakeService, tmp_path: Path
) -> None:
    folder = write(tmp_path / "walk", walk(40), num_images=40).parent
    done = panoloc("localize", "--session", folder, "--map", "map_1", "--json")
    assert len(fake.parts["image"]) == MAX_IMAGES
    assert "32 of 40 frames are sent" in done.err
    (document,) = done.documents
    assert document["session"] == str(folder)
    assert document["files"][-1].endswith("39.jpg")


def test_the_pose_of_every_image_and_of_the_session_is_printed(
    panoloc: Panoloc, fake: FakeService, tmp_path: Path
) -> None:
    answer = answer_with("localized")
    pose = answer["pose"]
    moved = {**pose, "map_from_camera": {**pose["map_from_camera"], "position_m": {"x": 7.5, "y": 0, "z": 1}}}
    camera = {"model": "pinhole", "hfov_deg": 69.0}
    answer["images"] = [{"pose": each, "agreement": 0.71, "camera": camera} for each in (pose, moved)]
    answer["map_from_session"] = {**pose["map_from_camera"], "position_m": {"x": -3.25, "y": 0, "z": 0}}
    fake.answer = answer
    done = panoloc(
        "localize", "--session", write(tmp_path / "walk", walk(2), num_images=2), "--map", "map_1", "--out", tmp_path
    )
    lines = done.out.splitlines()
    assert any(line.startswith("1.jpg") and "x 7.500" in line and "0.71" in line for line in lines)
    assert any(line.startswith("map from session") and "x -3.250" in line for line in lines)
    assert "18% of what the images show" in done.out
    assert (tmp_path / "walk.json").exists()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--session", "walk", "--hfov", "69"], "expected either images, or --session PATH"),
        (["--session", "walk", "photo.jpg"], "expected either images, or --session PATH"),
        ([], "expected at least one image, or --session PATH"),
        (["--session", "."], "expected a transforms.json"),
    ],
)
def test_a_session_stands_alone_and_is_a_file_of_frames(
    panoloc: Panoloc,
    fake: FakeService,
    panorama: Path,
    monkeypatch: pytest.MonkeyPatch,
    arguments: list[str],
    said: str,
) -> None:
    monkeypatch.chdir(panorama.parent)
    write(Path("walk"), walk(1))
    done = panoloc("localize", "--map", "map_1", *arguments)
    assert (done.code, fake.requests) == (2, [])
    assert said in done.said


@pytest.mark.parametrize(
    "content", [b"root:x:0:0:root:/root:/bin/bash", b"", b"\x89PNG", b"RIFF\x00\x00\x00\x00WAVE", b"GIF89a"]
)
def test_a_file_that_is_no_image_is_named_and_nothing_is_sent(
    panoloc: Panoloc, fake: FakeService, tmp_path: Path, content: bytes
) -> None:
    (tmp_path / "passwd").write_bytes(content)
    document = walk(2)
    document["frames"][1]["file_path"] = "../passwd"
    file = write(tmp_path / "walk", document, num_images=2)
    done = panoloc("localize", "--session", file, "--map", "map_1")
    assert (done.code, fake.requests) == (2, [])
    for said in ("frames[1] of ", "JPEG, PNG, WebP, HEIC or AVIF", "Nothing was sent"):
        assert said in done.said
    assert "root:" not in done.err


@pytest.mark.parametrize("kind", ["JPEG", "PNG", "WEBP"])
def test_images_beside_the_folder_of_the_file_are_sent(
    panoloc: Panoloc, fake: FakeService, tmp_path: Path, kind: str
) -> None:
    (tmp_path / "images").mkdir()
    Image.new("RGB", (8, 6)).save(tmp_path / "images" / "a", kind)
    file = write(tmp_path / "walk", one_frame(file_path="../images/a"))
    done = panoloc("localize", "--session", file, "--map", "map_1")
    assert done.code == 0, done.err
    assert fake.parts["image"] == [(tmp_path / "images" / "a").read_bytes()]


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs a file whose first bytes nobody can read")
def test_an_image_that_cannot_be_read_is_said_with_its_frame(tmp_path: Path) -> None:
    file = write(tmp_path, one_frame(file_path="/proc/self/mem"))
    with pytest.raises(TransformsError, match=r"frames\[0\] of .*/proc/self/mem: Input/output error"):
        read_transforms(file, "ros")
