"""Sums over patches, beside a product with who is where."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from panoloc.core.refine.patch_sums import PatchSums
from tests.core.other_device import DEVICE, OtherDevice


@settings(deadline=None)
@given(st.lists(st.integers(1, 40), min_size=1, max_size=30), st.integers(0, 2**16))
def test_they_are_the_product_with_who_is_where(sizes: list[int], seed: int) -> None:
    patches = torch.repeat_interleave(torch.arange(len(sizes)), torch.tensor(sizes))
    values = torch.randn((2, 3, len(patches)), generator=torch.Generator().manual_seed(seed))
    sums = PatchSums(patches)
    expected = values.double() @ torch.nn.functional.one_hot(patches).double()
    torch.testing.assert_close(sums(values).double(), expected, rtol=1e-4, atol=1e-4)
    # Also of planes that do not lie one after the other in memory.
    torch.testing.assert_close(sums(values.transpose(0, 1)), sums(values).transpose(0, 1))
    assert torch.equal(sums.spread(torch.arange(len(sizes))), patches)


@pytest.mark.slow
def test_another_device_adds_them_up_itself() -> None:
    patches, values = torch.tensor([0, 0, 1, 2, 2, 2]), torch.arange(12.0).view(2, 6)
    with torch.no_grad(), OtherDevice():
        there = PatchSums(patches.to(DEVICE))(values.to(DEVICE))
        assert there.device == DEVICE
        torch.testing.assert_close(there.cpu(), torch.tensor([[1.0, 2.0, 12.0], [13.0, 8.0, 30.0]]))


def test_points_that_do_not_follow_each_other_are_refused() -> None:
    with pytest.raises(AssertionError, match="follow each other"):
        PatchSums(torch.tensor([0, 1, 0]))
