"""Colours of labels, whatever the compression."""

import numpy as np
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from panoloc.core.light.color_equalization import label_codes


@given(hnp.arrays(np.uint8, st.tuples(st.integers(1, 30), st.just(3))), st.integers(-10, 10))
def test_label_colours_survive_the_noise_of_compression(labels: np.ndarray, noise: int) -> None:
    separated = (labels // 64 * 64 + 20).astype(np.uint8)
    codes = label_codes(torch.from_numpy(separated))
    exact, known = codes.recode(torch.from_numpy(separated))
    noisy, noisy_known = codes.recode(torch.from_numpy((separated.astype(int) + noise).astype(np.uint8)))
    assert bool(known.all())
    assert bool(noisy_known.all())
    assert torch.equal(exact, noisy)
    num_labels, num_codes = len(np.unique(separated, axis=0)), len(torch.unique(codes.codes, dim=0))
    assert num_labels == num_codes
