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
class RefinementConfig:
    """Refinement coarse to fine (see `panoloc.core.query.refinement`). Iterations: at most; rows: of a sphere."""

    # Coarse, on what starts see, at the rows of a view: points of what a rig shows; around it, as dense, a margin that poses may turn.
    coarse_points: int = 800
    coarse_margin_deg: float = 35.0
    robust_step: StepConfig = StepConfig(max_step_m=0.3, robust_scale=2.0)  # and of the first medium round
    # Of local contrast in the colours that are aligned: most where poses may lie far off in another light; half of it in medium rounds, and
    # a quarter where millimetres count.
    contrast: float = 0.8
    # Medium, on what poses themselves see, found anew in each of two rounds as that changes with them: at the rows of a view, where changed
    # furniture loses its vote, and at twice these; where poses are nearly right points keep it: they come half as near without.
    margin_deg: float = 8.0
    margin: float = 0.35  # of the best score; candidates further behind it never won
    medium_points: int = 2048
    # Fine, on images of so many rows and of twice as many; of rigs that cover little at twice these rows.
    fine_rows: int = 256
    fine_points: int = 12_000
    # Of the rendering that finds the points seen at full resolution; half where points fall into less than this share of the pixels: in a
    # room of 3,000 points poses are off by centimetres and not answered without.
    least_filled: float = 0.1
    step: StepConfig = StepConfig()
    iterations: int = 6  # twice as many of the coarse stage
    stop: StoppingRule = StoppingRule()
