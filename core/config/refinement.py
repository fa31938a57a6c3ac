"""Refinement, coarse to fine."""

from dataclasses import dataclass


@dataclass(frozen=True)
class StoppingRule:
    """When candidates stop before their last step; looked at after every `interval` steps.

    A candidate has converged whose last step turned it by less than so many pixels of the level, and moved it by less than as many would
    be a metre away. Of candidates that have come to the same pose the one with the smallest loss goes on alone.
    """

    pixels: float = 0.15
    interval: int = 2


@dataclass(frozen=True)
class StepConfig:
    """One step of Gauss-Newton (see `panoloc.core.refine.step`)."""

    damping: float = 0.05  # of the diagonal
    lengthening: float = 1.3  # of every step but the last
    max_step_m: float = 0.15
    robust_scale: float | None = (
        None  # of the median residual, at which a point counts a quarter; None: points keep their vote
    )


@dataclass(frozen=True)
class MediumRound:
    """One of the rounds between coarse and fine: rows of the level, degrees that a patch is high and wide, and robust scale."""

    rows: int
    patch_deg: float
    robust_scale: float | None


@dataclass(frozen=True)
class RefinementConfig:
    """Refinement coarse to fine (see `panoloc.core.query.refinement`). Iterations: at most; rows: of a sphere."""

    # Coarse, on what starts see, at half the rows of a view and at all of them: points, of what a rig shows that covers `coarse_share` or
    # less, more of others; around what images show, likewise dense, a margin that poses may turn.
    coarse_points: int = 400
    coarse_share: float = 0.085
    most_coarse_points: int = 1600
    coarse_margin_deg: float = 35.0
    coarse_step: StepConfig = StepConfig(damping=0.1, max_step_m=0.3, robust_scale=2.0)
    # Of local contrast in the colours that are aligned: most where poses may lie far off in another light; half of it in medium rounds, and
    # a quarter where millimetres count.
    contrast: float = 0.8
    # Medium, on what poses themselves see, found anew in each round as what a pose sees changes with it. Changed furniture loses its vote;
    # where poses are nearly right points keep it: they come half as near without.
    margin_deg: float = 8.0
    # Of the best score: candidates further behind it never won, and where nothing else was looked at a pose is taken to be so far ahead.
    margin: float = 0.35
    medium_points: int = 2048
    medium_rounds: tuple[MediumRound, ...] = (
        MediumRound(64, 22.5, 2.0),
        MediumRound(64, 22.5, 2.0),
        MediumRound(128, 11.25, None),
    )
    # Fine, on images of so many rows and of twice as many; of rigs that cover little at twice these rows.
    fine_candidates: int = 2
    fine_rows: int = 256
    fine_points: int = 8000
    finest_points: int = 12_000  # at twice those rows
    # Of the rendering that finds the points seen at full resolution; half where points fall into less than this share of the pixels: in a
    # room of 3,000 points poses are off by centimetres and not answered without.
    least_filled: float = 0.1
    step: StepConfig = StepConfig()
    iterations: int = 6  # twice as many of the coarse levels
    stop: StoppingRule = StoppingRule()
    # Of the points, by which halves of a picture are refined apart: with a quarter those of right poses end twice as far apart.
    halves_every: int = 2

    @property
    def finest_rows(self) -> int:
        """Return the rows of the finest images of rigs that cover little."""
        return 4 * self.fine_rows

    def coarse_points_of(self, share: float) -> int:
        """Return how many points are aligned on what starts see, of a rig that covers a `share` of the sphere."""
        return min(self.most_coarse_points, round(max(1.0, share / self.coarse_share) * self.coarse_points))
