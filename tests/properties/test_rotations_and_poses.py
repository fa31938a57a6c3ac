"""Rotations, quaternions, angles and frames, whatever the pose."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from panoloc.core.geometry.pose import FRAMES, Pose, matrix_from_quaternion, pose_error, quaternion_of
from panoloc.core.geometry.rotations import (
    rotation_angle,
    rotation_from_vector,
    rotation_spacing,
    uniform_rotations,
)
from panoloc.core.options import Frame
from tests.properties.strategies import Array, finite, matrix_of, quaternions, rotations, vectors


@given(quaternions)
def test_a_matrix_gives_back_its_quaternion_with_positive_w(quaternion: Array) -> None:
    found = quaternion_of(matrix_of(quaternion))
    assert found[3] >= 0
    assert abs(abs(float(found @ quaternion)) - 1) < 1e-9


@given(quaternions)
def test_the_matrix_of_a_quaternion_turns_vectors_as_the_quaternion_does(quaternion: Array) -> None:
    found = matrix_from_quaternion(quaternion)
    np.testing.assert_allclose(found, matrix_of(quaternion), atol=1e-9)


@given(rotations)
def test_yaw_pitch_roll_multiply_back_to_the_rotation(rotation: Array) -> None:
    yaw, pitch, roll = Pose(rotation, np.zeros(3)).yaw_pitch_roll
    assert -math.pi / 2 <= pitch <= math.pi / 2
    about_z = matrix_of(np.array([0, 0, math.sin(yaw / 2), math.cos(yaw / 2)]))
    about_y = matrix_of(np.array([0, math.sin(pitch / 2), 0, math.cos(pitch / 2)]))
    about_x = matrix_of(np.array([math.sin(roll / 2), 0, 0, math.cos(roll / 2)]))
    np.testing.assert_allclose(about_z @ about_y @ about_x, rotation, atol=2e-4)


@pytest.mark.parametrize("pitch", [math.pi / 2, -math.pi / 2])
def test_at_the_pole_roll_is_zero_and_the_product_still_holds(pitch: float) -> None:
    about_y = matrix_of(np.array([0, math.sin(pitch / 2), 0, math.cos(pitch / 2)]))
    about_z = matrix_of(np.array([0, 0, math.sin(0.6), math.cos(0.6)]))
    yaw, found_pitch, roll = Pose(about_z @ about_y, np.zeros(3)).yaw_pitch_roll
    assert (yaw, found_pitch, roll) == pytest.approx((1.2, pitch, 0.0))


@given(vectors.filter(lambda v: np.linalg.norm(v) > 1e-9))
def test_a_rotation_vector_turns_about_itself_by_its_length(vector: Array) -> None:
    rotation = rotation_from_vector(torch.from_numpy(vector)).numpy()
    np.testing.assert_allclose(rotation @ vector, vector, atol=1e-8 * (1 + float(np.linalg.norm(vector))))
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
    assert np.trace(rotation) == pytest.approx(1 + 2 * math.cos(np.linalg.norm(vector)), abs=1e-8)


@given(rotations, finite(-3, 3), st.sampled_from(range(3)))
def test_the_angle_between_rotations_is_the_angle_of_the_turn_between_them(
    rotation: Array, angle: float, axis: int
) -> None:
    vector = np.zeros(3)
    vector[axis] = angle
    turned = rotation @ rotation_from_vector(torch.from_numpy(vector)).numpy()
    found = float(rotation_angle(torch.from_numpy(rotation), torch.from_numpy(turned)))
    assert found == pytest.approx(abs(angle), abs=1e-6)
    error = pose_error(Pose(turned, np.zeros(3)), Pose(rotation, np.array([3.0, 4.0, 0.0])))
    assert error.orientation_deg == pytest.approx(math.degrees(abs(angle)), abs=1e-4)
    assert error.position_m == pytest.approx(5.0)


@given(rotations, vectors, rotations, vectors, st.sampled_from(FRAMES))
def test_in_every_frame_the_pose_of_a_camera_is_map_from_session_after_session_from_camera(
    turn: Array, shift: Array, rotation: Array, position: Array, frame: Frame
) -> None:
    map_from_session, session_from_camera = Pose(turn, shift), Pose(rotation, position)
    expected = map_from_session.after(session_from_camera).in_frame(frame).matrix
    found = map_from_session.between_worlds(frame).matrix @ session_from_camera.in_frame(frame).matrix
    np.testing.assert_allclose(found, expected, atol=1e-8)


# One pose as other systems write it, worked out apart from this code: heading 37.5, elevation -12.25, roll 4.75 degrees in a map that is
# east, north, up. `webxr` is glTF's row, `unity` Unity's, `opencv` the inverse of what COLMAP writes.
GOLDEN = {
    "ros": ((1.25, -2.5, 1.6), (-0.010196774, 0.113835941, 0.435420574, 0.892942511)),
    "opencv": ((1.25, -2.5, 1.6), (-0.726197900, 0.280580552, -0.176941385, 0.602165185)),
    "webxr": ((1.25, 1.6, 2.5), (-0.087704374, -0.323516864, -0.073283958, 0.939294545)),
    "unity": ((1.25, 1.6, -2.5), (0.087704374, 0.323516864, -0.073283958, 0.939294545)),
}


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("sent", FRAMES)
def test_one_pose_has_the_known_numbers_in_every_frame_whichever_it_came_in(frame: Frame, sent: Frame) -> None:
    position, quaternion = GOLDEN[frame]
    found = Pose.from_frame(*GOLDEN[sent], sent).in_frame(frame)
    np.testing.assert_allclose(found.position, position, atol=1e-9)
    np.testing.assert_allclose(found.quaternion_xyzw, quaternion, atol=2e-9)


@pytest.mark.slow
@pytest.mark.parametrize("count", [216, 2304])
def test_rotations_are_uniform_no_orientation_is_far_from_one_and_none_is_crowded(count: int) -> None:
    found = uniform_rotations(count).double()
    rng = np.random.default_rng(0)
    drawn = rng.normal(size=(1000, 4))
    drawn /= np.linalg.norm(drawn, axis=1, keepdims=True)
    probes = torch.from_numpy(np.stack([matrix_of(q) for q in drawn]))
    angles = torch.rad2deg(rotation_angle(probes[:, None], found[None]))
    # N caps of angle a fill the group when N (a − sin a) / π = 1; the covering radius of a good spread stays below twice that.
    ideal = next(a for a in np.linspace(0.01, 3, 3000) if count * (a - math.sin(a)) / math.pi >= 1)
    assert float(angles.amin(1).max()) < 2 * math.degrees(ideal)
    # The second smallest angle from a rotation to all of them is that to its nearest neighbour.
    apart = rotation_angle(found[:200, None], found[None]).topk(2, largest=False).values[:, 1]
    assert 0.75 < float(apart.mean()) / rotation_spacing(count) < 1.1
    within = (angles < 90).double().mean(1)
    expected = (math.pi / 2 - 1) / math.pi
    assert float((within - expected).abs().max()) < 0.25 * expected
    # First moments of a uniform spread vanish.
    assert float(found.mean(0).abs().max()) < 0.02
