"""Everything that a query is answered with."""

from dataclasses import dataclass

from panoloc.core.config.index import AliasConfig, DescriptorConfig
from panoloc.core.config.judge import ChangeConfig, JudgeConfig
from panoloc.core.config.lines import LineConfig
from panoloc.core.config.refinement import RefinementConfig
from panoloc.core.config.search import FocalConfig, SearchConfig


@dataclass(frozen=True)
class PaperConfig:
    """The paper's own parameters (§4 and supplement), and those of the reference implementation."""

    num_starts: int = 100
    num_rotations: int = 216
    num_candidates: int = 6
    search_rows: int = 8
    search_columns: int = 16
    map_rows: int = 16
    map_columns: int = 32
    bins: int = 8
    view_height: int = 128
    image_height: int = 512
    iterations: int = 100
    learning_rate: float = 0.1  # radians and metres; of the reference implementation
    learning_rate_decay: float = 0.8  # of the reference implementation
    patience: int = 5  # iterations without a smaller loss before it decays; of the reference implementation
    match_colors: bool = True
    initialize_by_histograms: bool = True
    initial_loss_points: int = 2_000  # where poses are initialized by the sampling loss instead
    use_score_map_2d: bool = True
    use_score_map_3d: bool = True


@dataclass(frozen=True)
class LocalizerConfig:
    """Everything that a query is answered with."""

    descriptors: DescriptorConfig = DescriptorConfig()
    aliases: AliasConfig = AliasConfig()
    search: SearchConfig = SearchConfig()
    focal: FocalConfig = FocalConfig()
    refinement: RefinementConfig = RefinementConfig()
    judge: JudgeConfig = JudgeConfig()
    change: ChangeConfig = ChangeConfig()
    lines: LineConfig = LineConfig()
    paper: PaperConfig = PaperConfig()
