"""Panoramas of any source as photos."""

from pathlib import Path

import numpy as np

from panoloc.core.geometry.pose import pose_error
from panoloc.lab.evaluation.known_cases import query_facts
from panoloc.lab.evaluation.photo_source import as_photos
from panoloc.lab.evaluation.sources import folder_scans


def test_each_panorama_is_cut_by_one_of_the_seeds_in_turn(box_folder: Path) -> None:
    first, second = as_photos(folder_scans(box_folder), "photo", [7, 8], width=64)
    assert first.query_names == ("q0.jpg@7", "q1.jpg@8")
    assert second.query_names == ("q0.jpg@7",)
    assert (first.name, first.group) == ("first/photo-64px", "first/photo")
    assert first.place == "first"


def test_a_photo_has_its_own_direction_and_the_place_of_its_panorama(box_folder: Path) -> None:
    panorama = folder_scans(box_folder)[0].load().query("q1.jpg")
    (scan, _) = as_photos(folder_scans(box_folder), "photo", [7, 8], width=64)
    photo, again = (scan.load().query("q1.jpg@8") for _ in range(2))
    assert photo.query.images[0].photo.color.shape == (48, 64, 3)
    np.testing.assert_array_equal(photo.query.images[0].photo.color, again.query.images[0].photo.color)
    np.testing.assert_array_equal(photo.poses[0].position, panorama.poses[0].position)
    # The photo shows in its middle what the panorama shows in that direction.
    looks = panorama.poses[0].rotation.T @ photo.poses[0].rotation[:, 0]
    height, width = panorama.panorama.valid.shape
    column = int((np.pi - np.arctan2(looks[1], looks[0])) / (2 * np.pi) * width) % width
    row = int((np.pi / 2 - np.arcsin(looks[2])) / np.pi * height)
    around = (
        panorama.panorama.color[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2].reshape(-1, 3).astype(int)
    )
    middle = photo.query.images[0].photo.color[23:25, 31:33].reshape(-1, 3).mean(0)
    assert np.abs(around - middle).sum(1).min() < 60


def test_frames_of_a_panorama_have_the_poses_of_their_session_but_for_the_noise(box_folder: Path) -> None:
    (scan, _) = as_photos(folder_scans(box_folder), "frames4", [3], width=64)
    known = scan.load().query("q0.jpg@3")
    poses = [image.session_from_camera for image in known.query.images]
    assert len(poses) == 4
    assert max(np.linalg.norm(pose.position - poses[0].position) for pose in poses) < 0.06
    turn = pose_error(poses[0], poses[1]).orientation_deg
    assert 45 < turn < 75
    assert query_facts(known) == {
        "camera": "pinhole",
        "num_images": 4,
        "hfov_deg": 69.0,
        "upright": "session",
    }


def test_defects_are_drawn_over_the_panoramas_of_any_source(box_folder: Path) -> None:
    whole = folder_scans(box_folder)[0].load().query("q0.jpg")
    spoilt, masked = (
        as_photos(folder_scans(box_folder), camera, [3])[0].load().query("q0.jpg@3")
        for camera in ("void", "void_masked")
    )
    np.testing.assert_array_equal(spoilt.panorama.color, masked.panorama.color)
    assert not masked.panorama.valid.all()
    assert (spoilt.panorama.color != whole.panorama.color).any()
    np.testing.assert_array_equal(spoilt.poses[0].matrix, whole.poses[0].matrix)
