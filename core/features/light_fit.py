"""Gain and offset per channel: the difference in light between a scan and a photo that is the same everywhere."""

from torch import Tensor

from panoloc.core.config import LIGHT_FIT


def fit_gain_offset(source: Tensor, target: Tensor, weights: Tensor) -> tuple[Tensor, Tensor]:
    """Return gain and offset (K, 3) that bring `source` (K, N, 3) nearest to `target`, weighted (K, N); gains stay within `LightFitConfig`.

    A small prior towards gain 1 keeps the fit defined where there is no contrast.
    """
    return fit_planes(source.transpose(1, 2).contiguous(), target.transpose(1, 2).contiguous(), weights)


def fit_planes(source: Tensor, target: Tensor, weights: Tensor) -> tuple[Tensor, Tensor]:
    """Do what `fit_gain_offset` does for planes (K, 3, N)."""
    share = weights / weights.sum(-1, keepdim=True).clamp_min(1e-9)
    mean_source, mean_target = weighted_sums(source, share), weighted_sums(target, share)
    centered = source - mean_source[..., None]
    weighted = centered * share[:, None]
    variance, covariance = (weighted * centered).sum(-1), (weighted * target).sum(-1)
    gain = ((covariance + LIGHT_FIT.prior) / (variance + LIGHT_FIT.prior)).clamp(LIGHT_FIT.min_gain, LIGHT_FIT.max_gain)
    return gain, mean_target - gain * mean_source


def weighted_sums(planes: Tensor, weights: Tensor) -> Tensor:
    """Return the sums (K, C) over the points of planes (K, C, N) weighted by (K, N)."""
    return (planes * weights[:, None]).sum(-1)
