"""The judge, and what has changed since the scan."""

from dataclasses import dataclass

from panoloc.core.config.search import PoseDistance


@dataclass(frozen=True)
class JudgeConfig:
    """The scan rendered at a refined pose against the panorama, and which poses differ (see `panoloc.core.decide`)."""

    first_height: int = 64  # rows of the rendering of all candidates
    height: int = 64  # and of those that are left then
    final_height: int = 128
    patch_rows: int = 8
    inlier_difference: float = 0.15  # canonical colour distance at which a pixel counts half
    brightness_bins: int = 16  # of the mutual information
    min_variance: float = 1e-4  # of canonical colours; below it contrast is noise
    min_patch_variance: float = 1e-3
    # Measured in patches that begin in the middle of those as well: a photo has thirty, and where their borders lie decides much.
    shifted_patches: bool = False
    ranks_by_explained: bool = False  # rather than by correlations (see `panoloc.core.decide.agreement`)
    # Of the score of photos, where lines agree with a rotation no more than with any (see `panoloc.core.lines`); of
    # ones in between, less.
    lines_share: float = 0.3
    merged: PoseDistance = PoseDistance(0.1, 3.0)  # before judgement
    distinct: PoseDistance = PoseDistance(0.15, 4.0)  # after judgement
    place: PoseDistance = PoseDistance(0.5, 15.0)  # beyond it poses are different answers
    # One of several images contradicts the pose of the others where its correlation and the share of its patches that agree are below
    # these, and its contrast is not (see `panoloc.core.decide.photo_agreement`); and the share of images that may.
    contradiction: float = 0.45
    contradicting_patches: float = 0.2
    telling_contrast: float = 0.15
    contradicting_share: float = 0.25
    # Photos of which the scan has less than this share at the pose found are localized only where the pose is this sure. Of 101 right
    # poses of photos and frames two had less, 0.93 and 0.99 sure; two wrong ones that were localized, 0.60 and 0.74 sure, 0.23 and 0.32.
    least_compared: float = 0.35
    sure_of_little: float = 0.9
    # What the tracking of several images adds to the radii of position and orientation, in quadrature: so many times its noise. With it
    # 0.66 and 0.67 of 290 right sessions are within their radii, which were fitted on none of them.
    tracking_radii: tuple[float, float] = (1.5, 1.0)
    # Images whose edges are together shorter than this show a plain wall. Of 127 photos of rooms the barest had 131 degrees, of 16 walls in
    # soft light, with and without grain, the richest 46; 20 degrees of a photo had 75 and were put elsewhere.
    least_edges_deg: float = 90.0
    agreement: float = 0.5  # correlation from which on a patch agrees, or an image surely shows what is there
    photo_patch_rows: int = 16  # from pole to pole: patches of 11 degrees, for each image alone
    rivals: int = 1  # places elsewhere that are judged as the best one is
    photo_rivals: int = 3  # likewise, of photos
    # Below this confidence, of photos below the second, so many places are refined fully, and ranked by all signs of confidence in place
    # of the score. Of panoramas, whose second best place is refined fully in any case, that costs next to nothing.
    weighed_below: float = 0.97
    photos_weighed_below: float = 0.7
    weighed_places: int = 6
    # Two places that both fit well are equals when their scores differ by less than both: of the score, and of the better one a share.
    ambiguous_margin: float = 0.1
    ambiguous_share: float = 0.15
    # Where it is known how alike the scan looks from both, as a share of the better one's score: below the first they are no equals, and
    # from the second on they are when they differ by less than the third.
    unlike_share: float = 0.6
    alike_share: float = 0.85
    alike_ambiguous_share: float = 0.3
    # Likewise where all that the scan shows looks the same from both: what a photo has of it then differs by what moved and by how both
    # rooms were sampled.
    same_view_ambiguous_share: float = 0.4
    # In the features of the confidence, of places without a runner-up, and where it was not measured how alike places look.
    unknown_relative_margin: float = 0.2
    unknown_distinctness: float = 0.5  # of panoramas, and where nothing is elsewhere
    # Logarithms of how many times nearer than what is right halves of the picture meet, and of how many times sharper than that the loss
    # is: within these, and these where they were not measured.
    halves_range: tuple[float, float] = (-1.0, 7.0)
    unknown_halves: float = 1.0
    sharpness_range: tuple[float, float] = (-1.0, 9.0)
    unknown_sharpness: float = 3.5
    unknown_lines: float = 0.8  # of panoramas, labels, and rooms that are not built along two axes


@dataclass(frozen=True)
class ChangeConfig:
    """What has changed since the scan (see `panoloc.core.decide.change_maps`)."""

    half_score_difference: float = 0.2  # of canonical colours; the score is 0.5 there
    changed_below: float = 0.5  # score
    sampled_points: int = 50_000  # of the scan, enough for a fraction
