"""Photos are compared with the scan by structure and colour: plain areas count, light does not."""

import numpy as np
import pytest
import torch

from panoloc.core.camera.rig import Panorama
from panoloc.core.changes.evidence import PhotoEvidence, photo_evidence
from panoloc.core.changes.voxels import LEAST_CHANGED, VoxelGrid, voxel_features
from panoloc.core.geometry.pose import Pose
from panoloc.core.geometry.projection import pixel_directions
from panoloc.core.render.render_cloud import make_render_cloud

SIDE_M = 2.0
WOOD, WALL, RUG = (0.60, 0.42, 0.26), (0.85, 0.84, 0.80), (0.5, 0.5, 0.5)
POINTS = 60


def box_room() -> tuple[torch.Tensor, torch.Tensor]:
    """Return points and colours of a cube around the origin: a floor of wood, plain walls and ceiling."""
    across = (np.arange(POINTS) + 0.5) / POINTS * 2 * SIDE_M - SIDE_M
    u, v = (each.ravel() for each in np.meshgrid(across, across))
    sides = []
    for axis in range(3):
        for end in (-SIDE_M, SIDE_M):
            face = np.insert(np.stack((u, v), 1), axis, end, axis=1)
            color = WOOD if (axis, end) == (2, -SIDE_M) else WALL
            sides.append((face, np.tile(color, (len(face), 1))))
    points, colors = (np.concatenate(part) for part in zip(*sides, strict=True))
    return torch.from_numpy(points).float(), torch.from_numpy(colors).float()


def photo(*, rug: bool, brightness: float) -> Panorama:
    """Return what a camera in the middle sees, with a plain rug of 1.6 m on the floor or without."""
    directions = pixel_directions(256, 512).double().numpy()
    scale = SIDE_M / np.abs(directions).max(-1, keepdims=True)
    place = directions * scale
    is_floor = place[..., 2] < -SIDE_M + 1e-9
    color = np.where(is_floor[..., None], WOOD, WALL)
    under = is_floor & (np.abs(place[..., :2] - (0.6, 0.0)) < 0.8).all(-1)
    color = np.where((under & rug)[..., None], RUG, color) * brightness
    return Panorama((color.clip(0, 1) * 255).astype(np.uint8), np.ones((256, 512), np.bool_))


def seen(*, rug: bool, brightness: float) -> tuple[PhotoEvidence, np.ndarray]:
    points, colors = box_room()
    cloud = make_render_cloud(points, colors, 2 * SIDE_M / POINTS)
    with_rug, without = (photo(rug=each, brightness=1.0).color.astype(int) for each in (True, False))
    found = photo_evidence(cloud, photo(rug=rug, brightness=brightness), Pose(np.eye(3), np.zeros(3)))
    return found, np.abs(with_rug - without).sum(-1) > 0


@pytest.mark.parametrize("brightness", [1.0, 0.6])
def test_a_plain_grey_rug_on_wood_is_changed_all_over_in_any_light(brightness: float) -> None:
    evidence, is_rug = seen(rug=True, brightness=brightness)
    changed = evidence.changed.numpy()
    assert (changed[is_rug] > 0.5).mean() > 0.85
    assert (changed[~is_rug] > 0.5).mean() < 0.02


def test_other_light_alone_is_no_change() -> None:
    evidence, _ = seen(rug=False, brightness=0.6)
    assert float((evidence.changed > 0.3).float().mean()) < 0.01  # but for corners, where pixels mix two colours
    assert bool(evidence.known.float().mean() > 0.95)


def test_a_voxel_knows_whether_it_lies_before_the_scanned_surface_or_at_it() -> None:
    evidence, _ = seen(rug=True, brightness=1.0)
    points, colors = box_room()
    grid = VoxelGrid(np.array([0.55, -0.05, -SIDE_M - 0.05]), (1, 1, 20), 0.1)
    features = voxel_features(grid, points.numpy(), colors.numpy(), [evidence])
    in_front, at_surface = features[LEAST_CHANGED][:, 0, 0]
    assert at_surface[0] > 0.5
    assert in_front[0] == 0
    assert in_front[10] > 0.5
    assert at_surface[10] == 0


def test_what_came_has_edges_in_the_photo_alone() -> None:
    evidence, is_rug = seen(rug=True, brightness=1.0)
    inner, outer = (
        torch.nn.functional.max_pool2d(torch.from_numpy(m).float()[None], 3, 1, 1)[0] > 0 for m in (is_rug, ~is_rug)
    )
    scan, photo = evidence.edges[:, inner & outer & evidence.known].mean(1).tolist()
    assert photo > 5 * scan
