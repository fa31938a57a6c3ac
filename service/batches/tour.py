"""Results of images as the tour that `panoloc.core.exports.tour.read_tour` reads; of batches, and of folders of the
command line."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from panoloc.service.jobs import ON_EARTH, Result


@dataclass
class TourDocument:
    """Photos of one map, added one by one. include_ambiguous: also those that fit several places."""

    map_id: str
    include_ambiguous: bool
    photos: list[dict[str, Any]] = field(default_factory=list)
    left_out: list[dict[str, str]] = field(default_factory=list)

    def why_not(self, result: Result | None) -> str | None:
        """Return why a photo is left out, None when it is not. result: None while there is none."""
        if result is None:
            return "waiting"
        if result["status"] == "failed":
            return f"failed: {result['error'].get('detail') or result['error'].get('title')}"
        if not _has_pose(result):
            return f"not_localized: no place fits well enough{_best_guess(result['answer'])}"
        if result["status"] == "ambiguous" and not self.include_ambiguous:
            guess = _best_guess(result["answer"])
            return f"ambiguous: several places fit about equally well{guess}; include ambiguous photos to export it"
        placed_in = result["answer"]["map_id"]
        return None if placed_in == self.map_id else f"placed in another map, {placed_in}"

    def add(self, name: str, image: Path, answer: Mapping[str, Any]) -> None:
        """Add a photo that is not left out."""
        pose, accuracy = answer["pose"]["map_from_camera"], answer["accuracy"] or {}
        images = answer.get("images") or [{"camera": {"model": "equirectangular"}}]
        self.photos.append(
            {
                "name": name,
                "image": str(image),
                "frame": answer["pose"]["frame"],
                "position_m": [pose["position_m"][axis] for axis in "xyz"],
                "quaternion_xyzw": [pose["quaternion"][axis] for axis in "xyzw"],
                "camera_model": images[0]["camera"]["model"],
                "confidence": answer["confidence"],
                "position_radius_m": accuracy.get("position_m"),
                "orientation_radius_deg": accuracy.get("orientation_deg"),
            }
        )

    def leave_out(self, name: str, reason: str) -> None:
        """Name a photo that is not written, and why."""
        self.left_out.append({"name": name, "reason": " ".join(reason.split())})

    def document(
        self,
        created_unix_s: float,
        place: Mapping[str, Any],
        scan: Path | None,
        survey: Path | None = None,
    ) -> dict[str, Any]:
        """Return the tour. place: document of a map, of which the place on Earth is used.

        scan: a PLY with the points of the map. survey: the scan itself, an E57.
        """
        return {
            "name": self.map_id,
            "created_unix_s": created_unix_s,
            **{name: place.get(name) for name in ON_EARTH},
            "scan": None if scan is None else str(scan),
            "survey": None if survey is None else str(survey),
            "photos": self.photos,
            "left_out": self.left_out,
        }


def maps_of(results: Iterable[Result]) -> list[str]:
    """Return the maps in which photos were placed, each once, sorted."""
    return sorted({result["answer"]["map_id"] for result in results if _has_pose(result)})


def _best_guess(answer: Mapping[str, Any]) -> str:
    return f", its best guess with a confidence of {answer['confidence']:.2f}" if answer["confidence"] else ""


def _has_pose(result: Result) -> bool:
    return result.get("answer") is not None and result["answer"]["pose"] is not None
