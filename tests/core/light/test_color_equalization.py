"""Canonical colours of images of which only a part is seen."""

import torch

from panoloc.core.light.color_equalization import apply_tables, equalization_tables, equalize_where


def test_equalizing_only_where_something_is_seen_gives_the_same_there_and_nothing_elsewhere() -> None:
    generator = torch.Generator().manual_seed(4)
    color = torch.rand((3, 200, 3), generator=generator)
    where = torch.rand((3, 200), generator=generator) < 0.2
    weights = torch.rand((3, 200), generator=generator) * where * (torch.arange(200) % 3 > 0)
    tables = equalization_tables(color, weights)
    expected = apply_tables(color, tables)
    found, found_tables = equalize_where(color, weights, where)
    assert torch.allclose(found_tables, tables, atol=1e-5)
    assert torch.allclose(found[where], expected[where], atol=1e-5)
    assert float(found[~where].abs().max()) == 0
