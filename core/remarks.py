"""What a caller should know of an answer: in words for people, and in one word for programs."""

from typing import Literal

Reason = Literal[
    "accuracy_too_low",
    "check_camera",
    "check_image",
    "hfov_contradicted",
    "images_contradict",
    "map_doubtful",
    "map_left_out",
    "map_not_ready",
    "name_fewer_maps",
    "not_kept",
    "nothing_in_reach",
    "placed_by_hand",
    "places_look_alike",
    "regions_ignored",
    "turn_more",
    "widen_hfov_range",
    "widen_hints",
]


class Remark(str):
    """The words. reason: what they say, or what the caller can do."""

    reason: Reason

    def __new__(cls, reason: Reason, words: str) -> "Remark":
        """Return the words with their reason."""
        remark = super().__new__(cls, words)
        remark.reason = reason
        return remark

    def __getnewargs__(self) -> tuple[Reason, str]:  # type: ignore[override]  # of pickle
        return self.reason, str(self)
