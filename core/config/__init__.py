"""Configuration: one frozen dataclass per step, each default in one place with its unit and its source.

Where no other source is named, a figure was chosen by measurement on cases with known poses (docs/experiments.md).
"""

from panoloc.core.config.distances import DISTANCES, PoseDistance, PoseDistances
from panoloc.core.config.imaging import CONTRAST, RENDERING, ContrastConfig, RenderingConfig
from panoloc.core.config.index import AliasConfig, DescriptorConfig, IndexConfig, StartsConfig
from panoloc.core.config.judge import ChangeConfig, JudgeConfig
from panoloc.core.config.lines import LineConfig
from panoloc.core.config.localizer import LocalizerConfig, PaperConfig
from panoloc.core.config.refinement import MediumRound, RefinementConfig, StepConfig, StoppingRule
from panoloc.core.config.search import (
    FocalConfig,
    SearchConfig,
)

__all__ = [
    "CONTRAST",
    "DISTANCES",
    "RENDERING",
    "AliasConfig",
    "ChangeConfig",
    "ContrastConfig",
    "DescriptorConfig",
    "FocalConfig",
    "IndexConfig",
    "JudgeConfig",
    "LineConfig",
    "LocalizerConfig",
    "MediumRound",
    "PaperConfig",
    "PoseDistance",
    "PoseDistances",
    "RefinementConfig",
    "RenderingConfig",
    "SearchConfig",
    "StartsConfig",
    "StepConfig",
    "StoppingRule",
]
