"""Configuration: one frozen dataclass per step, each default in one place with its unit and its source.

Where no other source is named, a figure was chosen by measurement on cases with known poses (docs/experiments.md).
"""

from panoloc.core.config.imaging import CONTRAST, LIGHT_FIT, RENDERING, ContrastConfig, LightFitConfig, RenderingConfig
from panoloc.core.config.index import DescriptorConfig, FineViewConfig, IndexConfig, StartsConfig
from panoloc.core.config.judge import ChangeConfig, JudgeConfig
from panoloc.core.config.lines import LineConfig
from panoloc.core.config.localizer import LocalizerConfig, PaperConfig
from panoloc.core.config.refinement import (
    HalvesConfig,
    PhotoRefinementConfig,
    RefinementConfig,
    StepConfig,
    StoppingRule,
)
from panoloc.core.config.search import (
    CameraCheckConfig,
    FieldOfViewConfig,
    PhotoSearchConfig,
    PoseDistance,
    SearchConfig,
)

__all__ = [
    "CONTRAST",
    "LIGHT_FIT",
    "RENDERING",
    "CameraCheckConfig",
    "ChangeConfig",
    "ContrastConfig",
    "DescriptorConfig",
    "FieldOfViewConfig",
    "FineViewConfig",
    "HalvesConfig",
    "IndexConfig",
    "JudgeConfig",
    "LightFitConfig",
    "LineConfig",
    "LocalizerConfig",
    "PaperConfig",
    "PhotoRefinementConfig",
    "PhotoSearchConfig",
    "PoseDistance",
    "RefinementConfig",
    "RenderingConfig",
    "SearchConfig",
    "StartsConfig",
    "StepConfig",
    "StoppingRule",
]
