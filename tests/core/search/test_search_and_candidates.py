"""The search over all starts and rotations, and the candidates that it names."""

import math

import torch

from panoloc.core.config import DescriptorConfig, SearchConfig
from panoloc.core.describe.spherical_patches import PatchGrid
from panoloc.core.geometry.pose import Pose
from panoloc.core.geometry.rotations import rotation_angle, uniform_rotations
from panoloc.core.index.map_index import MapIndex
from panoloc.core.panorama.panorama import Panorama
from panoloc.core.panorama.pyramid import PanoramaPyramid
from panoloc.core.search.map_search import describe_panorama, make_search_rotations, search_maps
from panoloc.core.search.pose_limits import PoseLimits
from panoloc.core.search.pose_scores import select_candidates

GRID = PatchGrid(DescriptorConfig().patch_rows, DescriptorConfig().patch_columns)


def test_excluded_poses_are_never_candidates() -> None:
    scores = torch.full((3, 5), -math.inf)
    scores[1, 2] = 0.5
    chosen = select_candidates(scores, torch.zeros((3, 3)), uniform_rotations(5), SearchConfig(num_candidates=4))
    assert chosen.starts.tolist() == [1]
    assert chosen.rotations.tolist() == [2]


def test_the_search_ranks_a_pose_near_the_true_one_among_the_first(
    box_index: MapIndex, box_panorama: Panorama, box_pose: Pose
) -> None:
    config = SearchConfig()
    rotations = make_search_rotations(config, GRID, torch.device("cpu"))
    described = describe_panorama(PanoramaPyramid(box_panorama, 64, None, "cpu"), None, DescriptorConfig())
    (result,) = search_maps([described], [box_index], rotations, [PoseLimits()], config)
    found, allowed = result.candidates, result.rotations
    assert result.num_starts == box_index.num_starts
    places = (box_index.starts[found.starts] - torch.from_numpy(box_pose.position).float()).norm(dim=-1)
    angles = rotation_angle(allowed[found.rotations], torch.from_numpy(box_pose.rotation).float())
    near = (places < 0.6) & (angles < math.radians(20))
    assert bool(near[:8].any())
