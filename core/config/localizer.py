"""Everything that a query is answered with."""

from dataclasses import dataclass, replace

from panoloc.core.config.index import DescriptorConfig, FineViewConfig
from panoloc.core.config.judge import ChangeConfig, JudgeConfig
from panoloc.core.config.lines import LineConfig
from panoloc.core.config.refinement import PhotoRefinementConfig, RefinementConfig, StepConfig
from panoloc.core.config.search import CameraCheckConfig, FieldOfViewConfig, PhotoSearchConfig, SearchConfig


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


_NARROW_SHARE = 0.3  # of the sphere


@dataclass(frozen=True)
class LocalizerConfig:
    """Everything that a query is answered with."""

    descriptors: DescriptorConfig = DescriptorConfig()
    search: SearchConfig = SearchConfig()
    photo_search: PhotoSearchConfig = PhotoSearchConfig()
    field_of_view: FieldOfViewConfig = FieldOfViewConfig()
    camera_check: CameraCheckConfig = CameraCheckConfig()
    photos: PhotoRefinementConfig = PhotoRefinementConfig()
    step: StepConfig = StepConfig()
    refinement: RefinementConfig = RefinementConfig()
    judge: JudgeConfig = JudgeConfig()
    change: ChangeConfig = ChangeConfig()
    paper: PaperConfig = PaperConfig()
    fine_views: FineViewConfig = FineViewConfig()
    lines: LineConfig = LineConfig()

    def for_photos(self, share: float) -> "LocalizerConfig":
        """Return the configuration for photos that show a `share` of the sphere: the less they show, the closer they are looked at."""
        is_narrow = share < _NARROW_SHARE
        finer = 2 if is_narrow else 1
        refinement, judge, photos = self.refinement, self.judge, self.photos
        margin_deg = photos.coarse_margin_deg if is_narrow else photos.wide_coarse_margin_deg
        return replace(
            self,
            photos=replace(photos, coarse_margin_deg=margin_deg),
            search=replace(
                self.search,
                num_candidates=self.photo_search.num_candidates,
                first_portion=self.photo_search.first_portion,
            ),
            step=replace(self.step, robust_scale=photos.robust_scale),
            refinement=replace(
                refinement,
                contrast_share=photos.contrast_share,
                fine_contrast_share=photos.fine_contrast_share,
                rough_damping=photos.damping,
                rough_max_relaxation=photos.max_relaxation,
                middle_candidates=photos.middle_candidates,
                middle_margin=photos.middle_margin,
                fine_margin=photos.fine_margin,
                middle_points=photos.middle_points,
                middle_rounds=tuple((rows, photos.robust_scale) for rows, _ in refinement.middle_rounds),
                fine_height=finer * refinement.fine_height,
                finest_height=finer * refinement.finest_height,
                fine_points=photos.fine_points,
                finest_points=photos.finest_points,
            ),
            judge=replace(
                judge,
                height=finer * judge.height,
                final_height=finer * judge.final_height,
                patch_rows=finer * judge.patch_rows,
                ranks_by_explained=True,
                rivals=judge.photo_rivals,
                weighed_below=judge.photos_weighed_below,
                shifted_patches=True,
            ),
        )
