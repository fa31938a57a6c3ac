"""The points that candidates are refined on."""

import torch

from panoloc.core.geometry.projection import project
from panoloc.core.geometry.rotations import even_directions
from panoloc.core.refine.candidate_points import points_seen_from_starts
from tests.core.built_maps import BOX, map_of

COUNT, HEIGHT = 512, 64


def test_points_of_a_start_are_seen_from_it() -> None:
    index = map_of(BOX)
    starts = torch.arange(0, index.num_starts, 40)
    _, fine = points_seen_from_starts(index, starts, HEIGHT, COUNT, 0.5)
    directions = even_directions(COUNT)
    for k, start in enumerate(starts):
        seen = fine.weights[k] > 0
        assert float(seen.float().mean()) > 0.3  # of a sparse scan, many pixels show no point
        relative = fine.positions[k][seen] - index.starts[start]
        cosine = (relative / relative.norm(dim=-1, keepdim=True) * directions[seen]).sum(-1)
        # A pixel of the view is 2.8 degrees high: the point kept for a direction lies in the same pixel.
        assert float(torch.rad2deg(torch.arccos(cosine.clamp(-1, 1))).max()) < 5
        for found, wanted in zip(
            project(relative, HEIGHT, 2 * HEIGHT), project(directions[seen], HEIGHT, 2 * HEIGHT), strict=True
        ):
            assert torch.equal(found.long(), wanted.long())


def test_both_resolutions_show_the_same_points_in_nearly_the_same_colours() -> None:
    index = map_of(BOX)
    coarse, fine = points_seen_from_starts(index, torch.tensor([3, 1]), HEIGHT, COUNT, 0.0)
    assert torch.equal(coarse.positions, fine.positions)
    assert torch.equal(coarse.weights, fine.weights)
    assert 0 < float((coarse.colors - fine.colors).abs().mean()) < 0.2
    swapped = points_seen_from_starts(index, torch.tensor([1, 3]), HEIGHT, COUNT, 0.0)[1]
    torch.testing.assert_close(swapped.colors.flip(0), fine.colors)
