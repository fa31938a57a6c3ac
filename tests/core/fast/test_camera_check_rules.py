"""When the focal length that photos want is taken, said, or left alone: the rules, with everything else made up."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
import torch

from core.camera.camera import Camera
from core.config import LocalizerConfig
from core.fast.camera_check import CheckedCameras, checked_cameras
from core.geometry.pose import Pose
from core.judge.hypotheses import Hypothesis, MethodResult
from core.panorama.session import Photo, Session, SessionImage
from core.refine.focal_refinement import FocalRefined
from core.stage_clock import StageClock

CONFIG = LocalizerConfig()
RULES = CONFIG.camera_check
STRONG, WEAK = 1.2 * RULES.contradicting, 0.8 * RULES.contradicting


def session(num_photos: int = 1) -> Session:
    camera = Camera.from_hfov("pinhole", 64, 48, 60.0)
    photo = Photo(np.zeros((48, 64, 3), np.uint8), np.ones((48, 64), bool), camera)
    return Session(tuple(SessionImage(photo, Pose(np.eye(3), np.zeros(3))) for _ in range(num_photos)))


def result(score: float, pull: float = 1.0) -> MethodResult:
    best = Hypothesis(0, 0, torch.eye(3), torch.zeros(3), score)
    return MethodResult([best], None, None, 1, 1, focal_pull=pull)


@dataclass
class Method:
    """Stands for `FastMethod`: wants the focal length longer by exp(log_factor), as strongly as said, and has `score` with it."""

    log_factor: float = -0.2
    strength: float = STRONG
    score: float = 1.2
    confidences: Sequence[float] = (0.9, 0.9)  # first of the answer given, then of that with the other focal length
    asked: list[str] = field(default_factory=list)
    searched: list[Session] = field(default_factory=list)

    def confidence_of_answer(self, _: object) -> float:
        return self.confidences[len(self.searched)]

    def with_focal(self, *_: object) -> FocalRefined:
        self.asked.append("focal")
        information = (self.strength / abs(self.log_factor)) ** 2
        return FocalRefined(torch.eye(3), torch.zeros(3), torch.tensor(self.log_factor), torch.tensor(information))

    def run(self, query: Session, *_: object) -> MethodResult:
        self.searched.append(query)
        return result(self.score)


def checked(method: Any, given: Session, found: MethodResult, timeout_s: float | None = None) -> CheckedCameras:
    return checked_cameras(method, given, [], None, StageClock(timeout_s, torch.device("cpu")), found, CONFIG)


def test_what_fits_better_with_another_focal_length_is_answered_with_it() -> None:
    method, given = Method(), session(3)
    found = checked(method, given, result(1.0))
    assert found.are_others
    assert found.result.hypotheses[0].score == method.score
    factors = [image.photo.camera.fx_px / given.images[0].photo.camera.fx_px for image in found.session.images]
    assert factors == pytest.approx([math.exp(-0.2)] * 3)
    information = (STRONG / 0.2) ** 2
    uncertainty = CONFIG.field_of_view.noise / math.sqrt(information)
    assert [image.photo.focal_uncertainty for image in found.session.images] == pytest.approx([uncertainty] * 3)
    (words,) = found.warnings
    assert words.startswith("the pose is for images of which the first is 70.4 degrees wide, not 60.0 as given")


@pytest.mark.parametrize(
    "method", [Method(score=1.0 + (RULES.better - 1) / 2), Method(confidences=(0.9, 0.0))], ids=["score", "confidence"]
)
def test_what_does_not_is_left_as_it_is_but_said(method: Method) -> None:
    given, before = session(), result(1.0)
    found = checked(method, given, before)
    assert found.session is given
    assert found.result is before
    assert not found.are_others
    (words,) = found.warnings
    assert words.startswith("some of what is seen would fit better for an image 70.4 degrees wide, not 60.0")


@pytest.mark.parametrize(("timeout_s", "searches"), [(1e-9, 0), (3600.0, 1)])
def test_nothing_is_localized_again_when_more_time_was_used_than_is_left(timeout_s: float, searches: int) -> None:
    method, given, before = Method(), session(), result(1.0)
    found = checked(method, given, before, timeout_s)
    assert len(method.searched) == searches
    assert found.are_others == bool(searches)
    assert found.warnings


@pytest.mark.parametrize(
    "method", [Method(strength=WEAK), Method(log_factor=RULES.least_log / 2)], ids=["weakly", "hardly"]
)
def test_what_wants_another_one_weakly_or_hardly_is_left_alone(method: Method) -> None:
    given, before = session(), result(1.0)
    assert checked(method, given, before) == CheckedCameras(given, before)
    assert method.asked == ["focal"]
    assert method.searched == []


@pytest.mark.parametrize(
    ("method", "pull"),
    [(Method(), 0.9 * RULES.suspect), (Method(confidences=(0.0,)), 1.0)],
    ids=["no pull", "no answer"],
)
def test_nothing_more_is_asked_without_a_pull_or_an_answer(method: Method, pull: float) -> None:
    given, before = session(), result(1.0, pull)
    assert checked(method, given, before) == CheckedCameras(given, before)
    assert method.asked == []
