"""A photo of a batch that a person places: from a rough pose, or from points clicked in the photo and in the scan.

The engine refines the pose and searches nowhere else. What a person confirms is shown and exported in place of the
answer of the search, which stays stored beside it.
"""

import asyncio
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from panoloc.core.camera.camera import CameraDescription
from panoloc.core.errors import PanoramaShapeError
from panoloc.core.geometry.pose import Pose, pose_error
from panoloc.core.image.known_camera import ShownCamera, shown_camera
from panoloc.core.options import Hints, PosePrior
from panoloc.core.survey.resection import Resection, resect, residuals_px
from panoloc.service.answer import (
    Accuracy,
    Change,
    ImageAnswer,
    ImageCamera,
    Localization,
    PoseAnswer,
)
from panoloc.service.batches.hand_evidence import (
    BY_HAND,
    LEVEL,
    UNMEASURED,
    Evidence,
    by_reason,
    checked,
    contradictions,
    of_engine,
    of_pairs,
    outside,
    uncompared,
)
from panoloc.service.batches.record import BatchRecord
from panoloc.service.batches.store import BatchStore
from panoloc.service.jobs import MapRef, QueryImage, new_id
from panoloc.service.localizations import Localizations, LocalizeRequest
from panoloc.service.maps.record import bounds_of
from panoloc.service.maps.selection import MapChoice, serving_ref
from panoloc.service.poses import PlaceOnEarth, geopose, pose_answer

Which = Literal["given", "refined"]
_MOST_REFINED = 3  # of several poses that points leave


@dataclass(frozen=True)
class Pairs:
    """Clicked points. pixels: (n, 2) of the photo as it is seen, upright, from its top left corner. points: (n, 3), metres in the map."""

    pixels: NDArray[np.float64]
    points: NDArray[np.float64]


@dataclass(frozen=True)
class ByHand:
    """What a person says: a rough pose, or pairs. position_std_m, orientation_std_deg: of a rough pose."""

    map_id: str
    pose: Pose | None
    pairs: Pairs | None
    position_std_m: float
    orientation_std_deg: float
    is_refined: bool


@dataclass(frozen=True)
class Placed:
    """A pose, with what speaks for it. residuals_px: of each pair."""

    pose: PoseAnswer
    residuals_px: list[float] | None
    evidence: Evidence


@dataclass(frozen=True)
class Placement:
    """What came of it. given: as it was set or solved. refined: by the engine; None where that was not asked for, or is impossible.

    better: which of both to take, by what speaks for them. answers: that a photo gets by whichever of them is confirmed.
    """

    given: Placed
    refined: Placed | None
    better: Which
    moved_m: float | None
    moved_deg: float | None
    answers: dict[Which, Localization]


class HandPlacing:
    """Used from one event loop."""

    def __init__(self, store: BatchStore, localizations: Localizations, max_pixels: int) -> None:
        self._store, self._localizations, self._max_pixels = store, localizations, max_pixels

    async def place(self, record: BatchRecord, number: int, by_hand: ByHand, request_id: str) -> Placement:
        """Solve and refine, and store nothing. Raises OptionsError for pairs that fix no pose, and what a query raises."""
        registry = self._localizations.registry
        await registry.find([by_hand.map_id])
        found_map = registry.seen_by(record.tenant).get(by_hand.map_id)
        ref, bounds = serving_ref(found_map), bounds_of(found_map)
        data = await self._store.image(record.id, number)
        seen, camera = await self._shown(record, number, data)
        guesses = await asyncio.to_thread(_guesses, by_hand, seen)
        photo = _Photo(record, seen, camera, by_hand.pairs, registry.georeferences([ref]).get(ref.id), ref, bounds)
        answers = [await self._refined(photo, data, guess, by_hand, request_id) for guess in guesses[:_MOST_REFINED]]
        found = [(guess, *refined) for guess, refined in zip(guesses, answers, strict=False) if refined is not None]
        if not found:
            given = photo.placed(guesses[0].pose, uncompared(guesses[0].evidence))
            return Placement(given, None, "given", None, None, {"given": photo.answer(given, None)})
        guess, pose, answer = max(found, key=lambda each: (each[2].images[0].agreement or -1.0, each[2].confidence))
        moved = pose_error(pose, guess.pose)
        evidence = guess.evidence if by_hand.pairs is None else checked(guess.evidence, answer, moved)
        given = photo.placed(guess.pose, evidence)
        refined = photo.placed(pose, of_engine(answer), answer.images[0].camera)
        doubts = contradictions(given.residuals_px, refined.residuals_px)
        refined.evidence.warnings.extend(doubts)
        # Clicked points are worth more than a refinement that leaves them, unless there are three, which always fit, or that the scan
        # hardly supports; a rough pose is not, unless that leaves it.
        is_left = moved.position_m > by_hand.position_std_m or moved.orientation_deg > by_hand.orientation_std_deg
        contradicted = bool(doubts) and guess.evidence.accuracy is not None
        is_doubted = contradicted or (answer.status != "localized" and (by_hand.pairs is not None or is_left))
        return Placement(
            given,
            refined,
            "given" if is_doubted else "refined",
            moved.position_m,
            moved.orientation_deg,
            {"given": photo.answer(given, None), "refined": photo.answer(refined, answer)},
        )

    async def confirm(self, record: BatchRecord, number: int, answer: Localization) -> None:
        """Store an answer of a placement: from now on the photo is where the person has placed it."""
        document = answer.model_dump(mode="json")
        await self._store.put_by_hand(record.id, number, {"status": "localized", "answer": document})

    async def undo(self, record: BatchRecord, number: int) -> None:
        """Return to the answer of the search."""
        await self._store.put_by_hand(record.id, number, None)

    async def _shown(
        self, record: BatchRecord, number: int, data: bytes
    ) -> tuple[ShownCamera, CameraDescription | None]:
        """Return the camera of a photo, and how it was described: with the batch, or with the query whose answer the batch was given."""
        described = record.camera
        try:
            return await asyncio.to_thread(shown_camera, data, described, self._max_pixels), described
        except PanoramaShapeError:
            answer = (await self._store.results(record.id, [number])).get(number, {}).get("answer")
            if answer is None or answer["images"][0]["camera"]["model"] != "pinhole":
                raise
            described = CameraDescription("pinhole", hfov_deg=answer["images"][0]["camera"]["hfov_deg"])
            return await asyncio.to_thread(shown_camera, data, described, self._max_pixels), described

    async def _refined(
        self, photo: "_Photo", data: bytes, guess: "_Guess", by_hand: ByHand, request_id: str
    ) -> tuple[Pose, Localization] | None:
        """Return what the engine makes of a guess, None where it compares nothing there."""
        if not by_hand.is_refined:
            return None
        position, turned = guess.pose.position.tolist(), guess.pose.quaternion_xyzw.tolist()
        prior = PosePrior(tuple(position), tuple(turned), "ros", guess.position_std_m, guess.orientation_std_deg, True)
        record = photo.record
        options = replace(record.options, method="fast", hints=Hints(prior=prior), artifacts=(), top_k=1)
        image = QueryImage(data, camera=photo.camera)
        choice = MapChoice((by_hand.map_id,), None, record.tenant)
        answer = await self._localizations.answer(LocalizeRequest((image,), choice, options, request_id))
        best = answer.pose or next((each.pose for each in answer.alternatives), None)
        if best is None:
            return None
        at, turn = best.map_from_camera.position_m, best.map_from_camera.quaternion
        return Pose.from_frame((at.x, at.y, at.z), (turn.x, turn.y, turn.z, turn.w), best.frame), answer


@dataclass(frozen=True)
class _Guess:
    pose: Pose
    position_std_m: float
    orientation_std_deg: float
    evidence: Evidence


@dataclass(frozen=True)
class _Photo:
    """The photo and the map in which it is placed. camera: as described, None where the file says it. place: of the map on Earth.

    bounds: of its scan.
    """

    record: BatchRecord
    seen: ShownCamera
    camera: CameraDescription | None
    pairs: Pairs | None
    place: PlaceOnEarth | None
    ref: MapRef
    bounds: Mapping[str, Sequence[float]] | None

    def placed(self, pose: Pose, evidence: Evidence, found: ImageCamera | None = None) -> Placed:
        """Return a pose with what speaks for it. found: the camera of a refined pose, which may have another field of view."""
        off, camera = None, self.seen.camera
        if found is not None and found.model == camera.model == "pinhole":
            factor = math.tan(math.radians(camera.hfov_deg) / 2) / math.tan(math.radians(found.hfov_deg) / 2)
            camera = replace(camera, fx_px=factor * camera.fx_px, fy_px=factor * camera.fy_px)
        if self.pairs is not None:
            pixels = self.pairs.pixels + self.seen.offset
            off = residuals_px(camera, pose, pixels, self.pairs.points).round(2).tolist()
        shown = pose_answer(pose, self.record.options.frame, self.place)
        warnings = [*evidence.warnings, *outside(pose.position, self.bounds)]
        return Placed(shown, off, replace(evidence, warnings=warnings))

    def answer(self, placed: Placed, engines: Localization | None) -> Localization:
        """Return the answer that the photo gets. engines: of a refined pose."""
        camera = self.seen.camera
        at, turn = placed.pose.map_from_camera.position_m, placed.pose.map_from_camera.quaternion
        pose = Pose.from_frame((at.x, at.y, at.z), (turn.x, turn.y, turn.z, turn.w), placed.pose.frame)
        found = engines and engines.images[0].camera
        image = ImageAnswer(
            pose=placed.pose,
            agreement=placed.evidence.agreement,
            camera=found or ImageCamera(model=camera.model, hfov_deg=round(camera.hfov_deg, 3)),
        )
        warnings = by_reason([BY_HAND, *placed.evidence.warnings])
        return Localization(
            id=engines.id if engines else new_id("loc"),
            status="localized",
            placed_by="hand",
            map_id=self.ref.id,
            map_revision=self.ref.revision,
            pose=placed.pose,
            map_from_session=placed.pose.map_from_camera,
            images=[image],
            geopose=geopose(pose, self.place),
            confidence=placed.evidence.confidence,
            accuracy=placed.evidence.accuracy or Accuracy(position_m=None, orientation_deg=None, level=LEVEL),
            alternatives=[],
            change=engines.change if engines else Change(panorama_changed_fraction=None, map_changed_fraction=None),
            timings_s=engines.timings_s if engines else {},
            search=engines.search if engines else {},
            warnings=list(warnings),
            reasons=[remark.reason for remark in warnings],
            artifacts={},
        )


def _guesses(by_hand: ByHand, seen: ShownCamera) -> list[_Guess]:
    if by_hand.pairs is None:
        assert by_hand.pose is not None
        return [_Guess(by_hand.pose, by_hand.position_std_m, by_hand.orientation_std_deg, UNMEASURED)]
    points = by_hand.pairs.points
    solved = resect(seen.camera, by_hand.pairs.pixels + seen.offset, points)

    def guess(each: Resection) -> _Guess:
        """Return one of the poses, as if it were the first."""
        ordered = [each, *(other for other in solved if other is not each)]
        return _Guess(each.pose, each.radius_m, each.radius_deg, of_pairs(ordered, len(points)))

    return [guess(each) for each in solved]
