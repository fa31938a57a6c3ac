"""How images are made and compared, alike for scan and photo and in every step."""

from dataclasses import dataclass


@dataclass(frozen=True)
class ContrastConfig:
    """Local contrast (see `panoloc.core.features.local_contrast`)."""

    darkest: float = 0.03  # colour, added before the logarithm: below it there is only noise
    rows: int = (
        16  # of the image in which surroundings are averaged; they are smooth, and four times as many rows tell them
    )
    concentration: float = 40.0  # of the weights around a direction: a standard deviation of 9 degrees
    scale: float = 0.5  # logarithm of the ratio at which contrast begins to saturate
    noise: float = 1e-3  # variance of colours in a patch below which contrast is noise

    @property
    def extent_rows(self) -> int:
        """Return the rows of the images that tell roughly what is shown."""
        return 2 * self.rows


@dataclass(frozen=True)
class RenderingConfig:
    """Synthetic views (see `panoloc.core.render.synthetic_view`)."""

    footprint: float = 1.5  # pixel size over point spacing at which a random sampling of a surface leaves few holes
    slack_spacings: float = 4.0  # depth range of one surface inside a pixel seen at a slant, in point spacings
    slack_share: float = 0.02  # likewise, of the depth
    fill_levels: int = 2  # holes up to 4 pixels are filled from their surroundings


CONTRAST, RENDERING = ContrastConfig(), RenderingConfig()
