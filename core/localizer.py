"""Localize a panorama in one or several maps: the public entrance to the methods `fast` and `paper`."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import torch

from panoloc.core.camera.rig import Photo, Rig
from panoloc.core.config import DISTANCES, LocalizerConfig
from panoloc.core.decide.agreement import agreement_by_photo
from panoloc.core.decide.change_maps import change_maps
from panoloc.core.decide.confidence import alias_margins, features_of, formal_radii, load_confidence_model
from panoloc.core.decide.hypotheses import Accuracy, Hypothesis, MethodResult
from panoloc.core.decide.verdict import Doubts, accuracy_too_low, is_elsewhere, verdict, with_advice
from panoloc.core.errors import OptionsError
from panoloc.core.geometry.pose import Pose
from panoloc.core.map.map_index import MapIndex
from panoloc.core.options import MAX_TOP_K, Hints, Method, PosePrior
from panoloc.core.paper.paper_method import PaperMethod
from panoloc.core.query.engine import Engine
from panoloc.core.query.focal_lengths import FoundCameras
from panoloc.core.render.comparison import Comparison
from panoloc.core.results import Candidate, Evidence, FoundImage, Localization, SearchSummary
from panoloc.core.stage_clock import StageClock


class Localizer:
    """Finds poses. Holds no state of queries, so one object serves any number of maps and threads.

    config: parameters of every step. device: "cpu", "cuda", ...; None chooses CUDA where it is there.
    """

    def __init__(self, config: LocalizerConfig | None = None, device: str | None = None) -> None:
        self.config = config or LocalizerConfig()
        self.device = torch.device(device or ("cuda" if torch.cuda.is_available() else "cpu"))
        self._confidence = load_confidence_model()
        self._doubts = Doubts(self.config.judge, self._confidence.threshold)
        self._engine = Engine(self.config, self._confidence)
        self._paper = PaperMethod(self.config, self.device)

    def localize(
        self,
        rig: Rig,
        maps: Sequence[MapIndex],
        *,
        method: Method = "fast",
        hints: Hints | None = None,
        top_k: int = 1,
        timeout_s: float | None = None,
        prior: float = 1.0,
        is_cancelled: Callable[[], bool] = lambda: False,
    ) -> Localization:
        """Find where the images of a rig were taken.

        maps: at least one index, on this localizer's device. hints narrow the search; the answer never exceeds them.
        top_k: how many poses to return in all; those after the best one come as alternatives. prior: how probable it is that the rig is in
        one of these maps, where there are others.
        is_cancelled: asked again and again whether nobody waits any more.
        Raises OptionsError for options out of range, and DeadlineExceededError when `timeout_s` passes or nobody waits any more.
        """
        if not maps:
            raise OptionsError("maps: expected at least one map to search")
        if not 1 <= top_k <= MAX_TOP_K:
            raise OptionsError(f"top_k: expected 1 to {MAX_TOP_K}, got {top_k}")
        if method not in ("fast", "paper"):
            raise OptionsError(f"method: expected fast or paper, got {method!r}")
        while True:
            clock = StageClock(timeout_s, self.device, is_cancelled)
            if method == "fast" or rig.photos[0].hfov_range_deg is not None:
                with torch.inference_mode():
                    result, cameras = self._engine.run(rig, maps, hints, clock)
            else:
                cameras = FoundCameras(rig)
            if method == "paper":
                result = self._paper.run(cameras.rig, maps, hints, clock)
            with torch.inference_mode():
                answer = self._answer(result, maps, method, top_k, clock, prior)
                answer = self._for_rig(answer, cameras.rig, maps, result.comparison, clock)
            answer = self._doubts.unless_plain(answer, result.edges_deg)
            answer = self._with_cameras(self._doubts.unless_at_bound(answer, cameras.bound_deg), cameras, result.noise)
            is_searched = result.num_starts or not result.hypotheses
            if answer.status != "not_localized" or is_searched or not hints or not hints.prior or hints.prior.is_only:
                return with_advice(answer, rig, hints)
            # What speaks against it came up when the search had been left out.
            hints = replace(hints, prior=None)
            timeout_s = None if timeout_s is None else timeout_s - sum(answer.timings_s.values())

    def _answer(
        self,
        result: MethodResult,
        maps: Sequence[MapIndex],
        method: Method,
        top_k: int,
        clock: StageClock,
        prior: float,
    ) -> Localization:
        """Turn hypotheses into an answer with confidence, accuracy and change maps."""
        search = SearchSummary(method, len(maps), result.num_starts, result.num_rotations, result.num_poses)
        if result.comparison is None:
            return Localization("not_localized", search, clock.timings_s)
        with clock.stage("confidence"):
            judged = verdict(result.hypotheses, self._confidence, result.noise, prior)
            places, status = judged.places, judged.status
            together = list(zip(places, judged.confidences, strict=True))[: max(top_k, judged.num_equals)]
            candidates = [_candidate(place, confidence, maps) for place, confidence in together]
        with clock.stage("change"):
            best, cloud = places[0], maps[places[0].map_number].render_cloud
            changes = change_maps(result.comparison, cloud, best.rotation, best.position, self.config.change)
        return Localization(
            status=status,
            search=search,
            timings_s=clock.timings_s,
            best=candidates[0],
            alternatives=tuple(candidates[1:]),
            accuracy_position_m=judged.accuracy.position_m,
            accuracy_orientation_deg=judged.accuracy.orientation_deg,
            panorama_changed_fraction=changes.panorama_changed_fraction,
            map_changed_fraction=changes.map_changed_fraction,
            score_pixels=changes.score_map_2d,
            score_points=changes.point_scores,
            evidence=Evidence(
                best.measures,
                features_of(best, places[1:]),
                alias_margins(best, places[1:]),
                max((h.score for h in places[1:]), default=None),
                formal_radii(best),
            ),
        )

    def _with_cameras(self, found: Localization, cameras: FoundCameras, noise: Accuracy) -> Localization:
        """Return the answer with what is known of the cameras, and what that leaves open."""
        if cameras.are_others:
            found = replace(found, found_cameras=tuple(photo.camera for photo in cameras.rig.photos))
        if cameras.warnings and found.status != "not_localized":
            found = found.warned(*cameras.warnings)
        if found.status == "not_localized" and noise.share_right < self._confidence.threshold:
            found = found.warned(accuracy_too_low(cameras.rig))
        return found

    def _for_rig(
        self,
        found: Localization,
        rig: Rig,
        maps: Sequence[MapIndex],
        comparison: Comparison | None,
        clock: StageClock,
    ) -> Localization:
        """Return the answer with poses of the first image, and those of all images at the best pose."""
        if found.best is None or comparison is None:
            return found
        first, rig_from_session = rig.images[0].session_from_camera, rig.session_from_rig.inverse()
        map_from_session = found.best.pose.after(rig_from_session)
        agreements = agreement_by_photo(comparison, len(rig.images), self.config.descriptors)
        images = [
            FoundImage(map_from_session.after(image.session_from_camera), agrees.correlation if agrees else None)
            for image, agrees in zip(rig.images, agreements, strict=True)
        ]
        index, expected = maps[found.best.map_position], images[0].pose
        found = self._doubts.unless_contradicted(
            found, agreements, lambda: self._is_alone_elsewhere(rig.photos[0], index, expected, clock)
        )
        found = found.with_each(lambda one: replace(one, pose=one.pose.after(rig_from_session).after(first)))
        return replace(found, map_from_session=map_from_session, images=tuple(images))

    def _is_alone_elsewhere(self, photo: Photo, index: MapIndex, expected: Pose, clock: StageClock) -> bool:
        """Return whether a photo by itself is surely elsewhere than expected, where it is looked for first."""
        x, y, z = expected.position.tolist()
        a, b, c, w = expected.quaternion_xyzw.tolist()
        around = DISTANCES.place
        prior = PosePrior((x, y, z), (a, b, c, w), "ros", around.distance_m, around.angle_deg)
        if photo.hfov_range_deg is not None:  # it has been found by all images
            photo = replace(photo, hfov_range_deg=None, focal_uncertainty=self.config.focal.noise)
        result, _ = self._engine.run(Rig.of_photo(photo), [index], Hints(prior=prior), clock)
        if not result.hypotheses:
            return False
        judged = verdict(result.hypotheses, self._confidence, result.noise)
        found = _candidate(judged.places[0], judged.confidences[0], [index])
        return is_elsewhere(judged, found.pose, expected)


def _candidate(hypothesis: Hypothesis, confidence: float, maps: Sequence[MapIndex]) -> Candidate:
    index = maps[hypothesis.map_number]
    # The nearest rotation: products of float32 rotations drift by 1e-6.
    u, _, vt = torch.linalg.svd(hypothesis.rotation.double().cpu())
    pose = Pose((u @ vt).numpy(), hypothesis.position.double().cpu().numpy() + index.origin_offset)
    return Candidate(
        pose=pose,
        map_position=hypothesis.map_number,
        confidence=confidence,
        score=hypothesis.score,
        sampling_loss=hypothesis.loss,
        color_model="labels" if index.labels is not None else hypothesis.color_model,
        num_iterations=hypothesis.iterations,
    )
