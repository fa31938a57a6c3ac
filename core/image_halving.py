"""Images made smaller and larger by powers of two."""

from torch import Tensor


def pool(level: Tensor, halvings: int) -> Tensor:
    """Sum (B, h, w, C) over squares of 2^halvings cells."""
    for _ in range(halvings):
        # Rows, then columns: a sum over two axes at once takes six times as long.
        rows = level[:, ::2] + level[:, 1::2]
        level = rows[:, :, ::2] + rows[:, :, 1::2]
    return level


def double(level: Tensor) -> Tensor:
    """Repeat rows and columns of (B, h, w, ...) twice."""
    return level.repeat_interleave(2, dim=1).repeat_interleave(2, dim=2)


def halve(color: Tensor, valid: Tensor) -> Tensor:
    """Average (B, H, W, 3) over squares of two valid pixels a side."""
    weight = valid[..., None].float()
    return pool(color * weight, 1) / pool(weight, 1).clamp_min(1e-6)
