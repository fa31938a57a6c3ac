"""Semantic labels have no light: their colour codes are recoded to well separated colours, of which averages mean something."""

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class LabelCodes:
    """Label colours of a map and the well separated colours that stand for them.

    labels: (L, 3) uint8 as integers, the colour codes in the scan. codes: (L, 3) float32 in 0..1.
    Averages of codes are averages of indicator functions, which interpolated label colours are not.
    """

    labels: Tensor
    codes: Tensor

    def to(self, device: torch.device | str) -> "LabelCodes":
        """Return the codes on `device`."""
        return LabelCodes(self.labels.to(device), self.codes.to(device))

    @property
    def key(self) -> bytes:
        """Return what codes of the same labels have in common, and others not; never empty."""
        return self.labels.cpu().numpy().tobytes()

    def recode(self, color: Tensor, tolerance: int = 24) -> tuple[Tensor, Tensor]:
        """Return codes (..., 3) of label colours (..., 3) uint8 and whether each is known (...) within `tolerance` per channel.

        The tolerance absorbs what JPEG does to flat colours.
        """
        keys, inverse = torch.unique(_packed(color.reshape(-1, 3)), return_inverse=True)
        distance = (_unpacked(keys)[:, None] - self.labels[None].int()).abs().amax(-1)
        nearest = distance.min(dim=1)
        code = self.codes[nearest.indices][inverse]
        known = (nearest.values <= tolerance)[inverse]
        return code.reshape(color.shape), known.reshape(color.shape[:-1])


def label_codes(colors: Tensor) -> LabelCodes:
    """Find the label colours among (N, 3) uint8 and give each a code; rare colours (below 0.01 %) count as noise."""
    keys, counts = torch.unique(_packed(colors), return_counts=True)
    labels = _unpacked(keys[counts >= max(1, int(1e-4 * len(colors)))])
    return LabelCodes(labels, _separated_colors(len(labels)).to(colors.device))


def _packed(color: Tensor) -> Tensor:
    """Return colours (N, 3) uint8 as one integer each (N,): sorting integers is ten times faster than sorting rows."""
    red, green, blue = color.int().unbind(-1)
    return (red << 16) | (green << 8) | blue


def _unpacked(keys: Tensor) -> Tensor:
    return torch.stack((keys >> 16, (keys >> 8) & 255, keys & 255), dim=-1)


def _separated_colors(count: int) -> Tensor:
    """Return `count` colours of a lattice in the unit cube, each as far from the ones before it as possible."""
    side = max(2, int(count ** (1 / 3)) + 2)
    axis = torch.linspace(0.05, 0.95, side)
    lattice = torch.stack(torch.meshgrid(axis, axis, axis, indexing="ij"), dim=-1).reshape(-1, 3)
    chosen = [0]
    distance = (lattice - lattice[0]).norm(dim=-1)
    while len(chosen) < count:
        chosen.append(int(distance.argmax()))
        distance = torch.minimum(distance, (lattice - lattice[chosen[-1]]).norm(dim=-1))
    return lattice[chosen]
