"""Localize a panorama in one or several maps: the public entrance to the methods `fast` and `paper`."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import torch

from panoloc.core.camera.panorama import Panorama
from panoloc.core.camera.rig import Photo, Session, left_out, session_from_rig
from panoloc.core.config import LocalizerConfig
from panoloc.core.decide.change_maps import ChangeMaps, change_maps
from panoloc.core.decide.confidence import error_radii, formal_radii, load_confidence_model
from panoloc.core.decide.doubts import Doubts
from panoloc.core.decide.hypotheses import Hypothesis, MethodResult
from panoloc.core.decide.photo_agreement import agreement_by_photo
from panoloc.core.decide.verdict import verdict
from panoloc.core.errors import OptionsError
from panoloc.core.fast.camera_check import CheckedCameras, checked_cameras
from panoloc.core.fast.fast_method import FastMethod
from panoloc.core.fast.field_of_view import bound_reached, searched_range_deg, with_focal_uncertainty, with_found_camera
from panoloc.core.geometry.pose import Pose
from panoloc.core.image.rig_on_sphere import session_on_sphere
from panoloc.core.map.map_index import MapIndex
from panoloc.core.options import MAX_TOP_K, Hints, Method
from panoloc.core.paper.paper_method import PaperMethod
from panoloc.core.render.comparison import Comparison
from panoloc.core.results import Candidate, Evidence, FoundImage, Localization, SearchSummary
from panoloc.core.stage_clock import StageClock

_HINTS_MAY_BE_WRONG = (
    "no pose within the hints fits well enough; if the hints could be wrong, widen them or leave them out"
)
_PANORAMA_MAY_BE_WRONG = (
    "no pose fits the panorama well enough; if it shows this place, much of what it shows has changed, or it is no full sphere: "
    "describe a crop or a stretched image in cameras"
)
_CAMERA_MAY_BE_WRONG = (
    "no pose fits the photo well enough; if it shows this place, much of what it shows has changed, or its field of view is not as given "
    "(a crop, a zoom): let it be searched with hfov_range_deg"
)
_CAMERAS_MAY_BE_WRONG = (
    "no pose fits the images well enough; if they show this place, much of what they show has changed, "
    "or cameras, session_from_camera or frame are not as given"
)


class Localizer:
    """Finds poses. Holds no state of queries, so one object serves any number of maps and threads.

    config: parameters of every step. device: "cpu", "cuda", ...; None chooses CUDA where it is there.
    """

    def __init__(self, config: LocalizerConfig | None = None, device: str | None = None) -> None:
        self.config = config or LocalizerConfig()
        self.device = torch.device(device or ("cuda" if torch.cuda.is_available() else "cpu"))
        self._confidence = load_confidence_model()
        self._doubts = Doubts(self.config.judge, self._confidence.threshold)
        self._fast = FastMethod(self.config, self.device, self._confidence)
        self._paper = PaperMethod(self.config, self.device)

    def localize(
        self,
        query: Panorama | Photo | Session,
        maps: Sequence[MapIndex],
        *,
        method: Method = "fast",
        hints: Hints | None = None,
        top_k: int = 1,
        timeout_s: float | None = None,
    ) -> Localization:
        """Find where a panorama, a photo, or the photos of a session were taken.

        maps: at least one index, on this localizer's device. hints narrow the search; the answer never exceeds them.
        top_k: how many poses to return in all; those after the best one come as alternatives.
        Raises OptionsError for options out of range and DeadlineExceededError when `timeout_s` passes.
        """
        if not maps:
            raise OptionsError("maps: expected at least one map to search")
        if not 1 <= top_k <= MAX_TOP_K:
            raise OptionsError(f"top_k: expected 1 to {MAX_TOP_K}, got {top_k}")
        clock = StageClock(timeout_s, self.device)
        if isinstance(query, Photo):
            query = Session.of_photo(query)
        bound_deg: float | None = None
        checked: CheckedCameras | None = None
        range_deg = searched_range_deg(query) if isinstance(query, Session) else None
        if isinstance(query, Session) and range_deg is not None:
            with torch.inference_mode():
                query = with_found_camera(self._fast, query, maps, hints, clock, self.config.field_of_view)
            bound_deg = bound_reached(query.images[0].photo.camera, range_deg)
        with torch.inference_mode(method == "fast"):
            if method == "fast":
                result = self._fast.run(query, maps, hints, clock)
                if isinstance(query, Session) and range_deg is None:
                    checked = checked_cameras(self._fast, query, maps, hints, clock, result, self.config)
                    result = checked.result
            elif method == "paper":
                panorama = query if isinstance(query, Panorama) else session_on_sphere(query)[0]
                result = self._paper.run(panorama, maps, hints, clock)
            else:
                raise OptionsError(f"method: expected fast or paper, got {method!r}")
        with torch.inference_mode():
            answer = self._answer(result, maps, method, top_k, clock)
        answer = self._with_noise_of(answer, query)
        if isinstance(query, Session):
            cameras = checked or CheckedCameras(query, result, are_others=range_deg is not None)
            answer = self._for_session(answer, cameras.session, result.comparison)
            answer = self._doubts.unless_at_bound(self._doubts.unless_plain(answer, result.edges_deg), bound_deg)
            answer = self._with_cameras(answer, cameras)
        if answer.status == "not_localized" and not answer.warnings:
            answer = replace(answer, warnings=why_nothing_fits(query, hints, range_deg is not None))
        return replace(answer, warnings=(*answer.warnings, *left_out(query)))

    def _answer(
        self, result: MethodResult, maps: Sequence[MapIndex], method: Method, top_k: int, clock: StageClock
    ) -> Localization:
        """Turn hypotheses into an answer with confidence, accuracy and change maps."""
        sizes = self.config.search if method == "fast" else self.config.paper
        search = SearchSummary(method, len(maps), result.num_starts, sizes.num_rotations, result.num_poses)
        if not result.hypotheses:
            warning = (
                "no pose in reach of the scan and within the hints fits after refinement; widen these or leave them out"
                if result.num_poses
                else "the hints leave no pose to search; widen them or leave them out"
            )
            return Localization("not_localized", search, clock.timings_s, warnings=(warning,))
        with clock.stage("confidence"):
            judged = verdict(result.hypotheses, self._confidence, self.config.judge)
            places, status = judged.places, judged.status
            together = list(zip(places, judged.confidences, strict=True))[: max(top_k, 4)]
            candidates = [_candidate(place, confidence, maps) for place, confidence in together]
            formal = formal_radii(places[0])
            position_m, orientation_deg = error_radii(formal, places[0].measures, self._confidence)
        changes: ChangeMaps | None = None
        if result.comparison is not None and result.cloud is not None:
            with clock.stage("change"):
                best = places[0]
                changes = change_maps(result.comparison, result.cloud, best.rotation, best.position, self.config.change)
        shown = len(candidates) if status == "ambiguous" else top_k
        return Localization(
            status=status,
            search=search,
            timings_s=clock.timings_s,
            best=candidates[0],
            alternatives=tuple(candidates[1:shown]),
            accuracy_position_m=position_m,
            accuracy_orientation_deg=orientation_deg,
            panorama_changed_fraction=changes.panorama_changed_fraction if changes else None,
            map_changed_fraction=changes.map_changed_fraction if changes else None,
            score_map_2d=changes.score_map_2d if changes else None,
            score_points=changes.point_scores if changes else None,
            evidence=Evidence(places[0].measures, max((h.score for h in places[1:]), default=None), formal),
        )

    def _with_noise_of(self, found: Localization, query: Panorama | Session) -> Localization:
        """Return the answer with radii that contain what the tracking of several images adds to the pose of the first."""
        position, orientation = found.accuracy_position_m, found.accuracy_orientation_deg
        if position is None or orientation is None or isinstance(query, Panorama) or len(query.images) == 1:
            return found
        by_position, by_orientation = self.config.judge.tracking_radii
        return replace(
            found,
            accuracy_position_m=math.hypot(position, by_position * query.options.position_noise_m),
            accuracy_orientation_deg=min(
                math.hypot(orientation, by_orientation * query.options.orientation_noise_deg), 180.0
            ),
        )

    def _with_cameras(self, found: Localization, cameras: CheckedCameras) -> Localization:
        """Return the answer with what is known of the cameras, and what that leaves open."""
        images = [image.photo for image in cameras.session.images]
        if cameras.are_others:
            found = replace(found, found_cameras=tuple(photo.camera for photo in images))
        if cameras.warnings and found.status != "not_localized":
            found = replace(found, warnings=(*found.warnings, *cameras.warnings))
        uncertainty = max(photo.focal_uncertainty for photo in images)
        if not uncertainty:
            return found
        found = with_focal_uncertainty(found, cameras.result.comparison, uncertainty)
        return self._doubts.unless_focal_length_matters(found)

    def _for_session(self, found: Localization, session: Session, comparison: Comparison | None) -> Localization:
        """Return the answer with poses of the first image, and those of all images at the best pose."""
        if found.best is None:
            return found
        first, rig_from_session = session.images[0].session_from_camera, session_from_rig(session).inverse()

        def of_first(candidate: Candidate) -> Candidate:
            """Return the candidate with the pose of the first image in place of the rig's."""
            return replace(candidate, pose=candidate.pose.after(rig_from_session).after(first))

        map_from_session = found.best.pose.after(rig_from_session)
        agreements = agreement_by_photo(comparison, len(session.images), self.config.judge)
        images = [
            FoundImage(map_from_session.after(image.session_from_camera), agrees.correlation if agrees else None)
            for image, agrees in zip(session.images, agreements, strict=True)
        ]
        found = self._doubts.unless_seen_little_of(self._doubts.unless_contradicted(found, agreements))
        assert found.best is not None
        return replace(
            found,
            best=of_first(found.best),
            alternatives=tuple(map(of_first, found.alternatives)),
            map_from_session=map_from_session,
            images=tuple(images),
        )


def why_nothing_fits(query: Panorama | Session, hints: Hints | None, was_searched: bool) -> tuple[str, ...]:
    """Say what may be wrong with a query that no pose fits well. was_searched: whether its field of view was."""
    reasons = [] if hints is None else [_HINTS_MAY_BE_WRONG]
    if isinstance(query, Panorama):
        reasons.append(_PANORAMA_MAY_BE_WRONG)
    elif not was_searched:
        reasons.append(_CAMERA_MAY_BE_WRONG if len(query.images) == 1 else _CAMERAS_MAY_BE_WRONG)
    return tuple(reasons)


def _candidate(hypothesis: Hypothesis, confidence: float, maps: Sequence[MapIndex]) -> Candidate:
    index = maps[hypothesis.map_number]
    pose = Pose(_orthonormal(hypothesis.rotation), hypothesis.position.double().cpu().numpy() + index.origin_offset)
    return Candidate(
        pose=pose,
        map_position=hypothesis.map_number,
        confidence=confidence,
        score=hypothesis.score,
        sampling_loss=hypothesis.loss,
        color_model="labels" if index.labels is not None else hypothesis.color_model,
        num_iterations=hypothesis.iterations,
    )


def _orthonormal(rotation: torch.Tensor) -> Any:
    """Return the nearest rotation (3, 3) float64 as numpy: products of float32 rotations drift by 1e-6."""
    u, _, vt = torch.linalg.svd(rotation.double().cpu())
    return (u @ vt).numpy()
