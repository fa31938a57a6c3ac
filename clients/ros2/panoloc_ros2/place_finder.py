"""What the node does, free of any transport: messages in, `map` → `odom` out, queries in the background.

Time is that of the stamps: whatever happens, happens when odometry comes.
"""

import math
import time
from concurrent.futures import Future
from typing import Any, Protocol

from .estimate import Estimate, Measurement, Spread, Travel
from .frames import Frame, Frames
from .images import UnusableError, camera_entry, check_image
from .parameters import Parameters
from .poses import Pose, distance_between, from_json
from .service import Ask, NoAnswerError, Query, in_background
from .transforms import Transforms, seconds

_LEAST_STEP = Travel(0.01, math.radians(0.5))  # less is noise, which would add up
_MAX_SPEED_MPS = 10.0  # faster than any robot: its odometry was set anew
_MAX_TURN_RADPS = math.radians(60.0)  # beyond, images are blurred
_TURN_OVER_S = 0.1
_FAR_TURN_RAD = math.radians(90.0)  # shows as much of a place as a way does
_LOOK_EVERY_S = 0.2
_MAX_WAIT_S = 0.3  # of an image for the tf of its time
_MANY_MISSED = 5


class Outlet(Protocol):
    """Where results go: one for each transport. Stamps are seconds; covariances 6 x 6 are diagonal."""

    def send_transform(self, stamp: float, map_from_odom: Pose) -> None:
        """Publish `map` → `odom`."""

    def send_pose(self, stamp: float, map_from_base: Pose, spread: Spread, is_initial: bool) -> None:
        """Publish the robot's pose with its covariance, on `/initialpose` or on `~/pose`."""

    def info(self, text: str) -> None:
        """Log."""

    def warning(self, text: str) -> None:
        """Log."""


class PlaceFinder:
    """One robot with one camera. Its methods return at once and are called from one thread."""

    def __init__(self, parameters: Parameters, outlet: Outlet, ask: Ask | None = None) -> None:
        """ask: replaces the service, for tests."""
        self._parameters, self._outlet = parameters, outlet
        self._ask = ask or in_background(parameters.url, parameters.map)
        self._transforms, self._info, self._image, self._said = Transforms(parameters.odom_frame), None, None, ""
        self._has_images = False
        self._asking: tuple[Query, Future[dict[str, Any]]] | None = None
        self._wait_until = 0.0  # of the clock of this machine, which the service's `Retry-After` is about
        self._start_anew()

    def _start_anew(self) -> None:
        self._estimate = Estimate(self._parameters.odometry_drift, self._parameters.min_confidence)
        self._frames, self._travel, self._image = Frames(), Travel(), None
        self._now: tuple[float, Pose] | None = None
        self._step: tuple[float, Pose] | None = None
        self._asked, self._published, self._looked = (-math.inf, Travel()), -math.inf, -math.inf
        self._asking, self._num_missed, self._is_lost = None, 0, False

    @property
    def wants_image(self) -> bool:
        """Return whether the next image would be looked at; others need not be read."""
        return self._image is None and self._now is not None and self._now[0] - self._looked >= _LOOK_EVERY_S

    def on_tf(self, message: Any, is_static: bool = False) -> None:
        """Take a message of /tf or /tf_static."""
        if not self._transforms.add(message, is_static):
            self._restart("time went back")
        now = self._transforms.latest(self._parameters.base_frame)
        if now is None or (self._now is not None and now[0] <= self._now[0]):
            return
        self._now = now
        self._measure_travel(*now)
        self._take_frame(now[0])
        self._take_answer(*now)
        self._ask_if_due(now[0])
        self._publish_if_due(*now)

    def on_camera_info(self, message: Any) -> None:
        """Keep the intrinsics."""
        self._info = message

    def on_image(self, message: Any) -> None:
        """Keep an Image or CompressedImage until the tf of its time is there."""
        self._has_images = True
        if self.wants_image:
            self._image = message

    def say_what_is_missing(self) -> None:
        """Warn of inputs that have never come; to be called every few seconds."""
        names, missing = self._parameters, []
        if self._now is None:
            missing.append(f"tf from {names.odom_frame!r} to {names.base_frame!r}")
        if self._info is None:
            missing.append(names.camera_info_topic)
        if not self._has_images and self._now is not None:  # before, nobody reads them
            missing.append(names.image_topic)
        if missing:
            self._say(f"nothing came yet: {', '.join(missing)}; check names, types, domain and network")

    def _measure_travel(self, stamp: float, odom_from_base: Pose) -> None:
        if self._step is None:
            self._step = stamp, odom_from_base
        moved_m, turned_rad = distance_between(self._step[1], odom_from_base)
        if moved_m > max(1.0, _MAX_SPEED_MPS * (stamp - self._step[0])):
            self._restart(f"{self._parameters.odom_frame} jumped by {moved_m:.1f} m")
            self._now = self._step = stamp, odom_from_base
        elif Travel(moved_m, turned_rad).shows_more_than(_LEAST_STEP):
            self._travel = Travel(self._travel.distance_m + moved_m, self._travel.turn_rad + turned_rad)
            self._step = stamp, odom_from_base
        else:
            self._step = stamp, self._step[1]

    def _restart(self, reason: str) -> None:
        self._outlet.warning(f"{reason}: localizing anew")
        self._start_anew()

    def _take_frame(self, now: float) -> None:
        """Keep the image that waits, if it shows something new."""
        image, info, names = self._image, self._info, self._parameters
        if image is None:
            return
        if info is None:
            return
        stamp, optical = seconds(image.header.stamp), names.camera_frame or image.header.frame_id.lstrip("/")
        odom_from_camera = self._transforms.at(optical, stamp)
        if odom_from_camera is None:
            if now > stamp + _MAX_WAIT_S:
                self._image, self._num_missed = None, self._num_missed + 1
            if self._num_missed >= _MANY_MISSED:
                self._say(
                    f"no tf from {names.odom_frame!r} to {optical!r} at the times of the images: where that is not the optical "
                    "frame, set camera_frame"
                )
            return
        self._image, self._num_missed, self._looked = None, 0, stamp
        if self._is_turning_fast(stamp) or not (self._is_due(now) or self._frames.is_new(odom_from_camera)):
            return
        try:
            check_image(image)
            entry = camera_entry(info, odom_from_camera, names.rectified)
        except UnusableError as error:
            self._say(str(error))
            return
        self._frames.add(Frame(stamp, image, entry, odom_from_camera, self._travel))

    def _is_turning_fast(self, stamp: float) -> bool:
        before, after = (
            self._transforms.at(self._parameters.base_frame, each) for each in (stamp - _TURN_OVER_S, stamp)
        )
        if before is None or after is None:
            return False
        return distance_between(before, after)[1] > _MAX_TURN_RADPS * _TURN_OVER_S

    @property
    def _is_tracking(self) -> bool:
        return self._estimate.map_from_odom is not None and not self._estimate.is_doubted and not self._is_lost

    def _is_due(self, now: float) -> bool:
        """Tell whether to ask with the next image, whatever it shows."""
        wanted, (stamp, travel) = self._parameters, self._asked
        if now - stamp >= wanted.period_s or not self._is_tracking:
            return now - stamp >= wanted.period_s
        is_far = self._travel.since(travel).shows_more_than(Travel(wanted.distance_m, _FAR_TURN_RAD))
        return is_far or self._estimate.spread_at(self._travel).position_m >= wanted.max_std_m

    def _ask_if_due(self, now: float) -> None:
        frames = tuple(self._frames.kept)
        if self._asking or not frames or frames[0].stamp <= self._asked[0] or time.monotonic() < self._wait_until:
            return
        # Who knows the place waits for an image of now; who does not asks about each new one.
        if self._is_tracking and not (self._is_due(now) and frames[0].stamp == self._looked):
            return
        known, expected = self._estimate.map_from_odom, None
        if known is not None and not self._estimate.is_doubted:
            expected = known @ frames[0].odom_from_camera, self._estimate.spread_at(frames[0].travel)
        # The service wants that of any two frames, which are half as far apart as the first and the last.
        noise = Spread(0.0, 0.0).after(frames[0].travel.since(frames[-1].travel), self._parameters.odometry_drift / 2)
        query = Query(frames, noise, expected)
        self._asking = query, self._ask(query)

    def _take_answer(self, now: float, odom_from_base: Pose) -> None:
        """Weigh an answer that has come, or say why there is none."""
        if self._asking is None or not self._asking[1].done():
            return
        (query, future), self._asking = self._asking, None
        first = query.frames[0]
        try:
            answer = future.result()
        except NoAnswerError as error:
            self._say(str(error))
            self._wait_until = time.monotonic() + error.retry_after_s
            return
        self._asked = first.stamp, first.travel
        contradict = "images_contradict" in answer["reasons"]
        if answer["status"] != "localized" or contradict:
            self._say(f"{answer['status']}: {' '.join(answer['warnings'])}")
            # Wheels may have slipped among these frames, or somebody has carried the robot away: new ones will tell.
            self._is_lost = True
            if contradict or self._estimate.map_from_odom is not None:
                self._frames.start_anew()
            return
        for warning in answer["warnings"]:
            self._outlet.warning(warning)
        map_from_odom = from_json(answer["map_from_session"])
        found = Measurement.of_accuracy(map_from_odom, answer["accuracy"], first.travel, answer["confidence"])
        before = self._estimate.map_from_odom
        verdict = self._estimate.take(found, odom_from_base, self._travel)
        self._is_lost, self._said = False, ""
        x, y, _ = (map_from_odom @ odom_from_base).position
        moved_m = (
            0.0 if before is None else distance_between(before @ odom_from_base, map_from_odom @ odom_from_base)[0]
        )
        text = f"at ({x:.2f}, {y:.2f}) m, confidence {answer['confidence']:.2f}, {moved_m:.2f} m off: {verdict}"
        self._outlet.info(text + ("; drive or turn for a second answer" if verdict == "doubted" else ""))
        if verdict in ("moved", "doubted"):
            self._frames.start_anew()
        if verdict in ("first", "moved"):
            self._publish(now, odom_from_base, is_initial=True)

    def _publish_if_due(self, now: float, odom_from_base: Pose) -> None:
        # Half a millisecond for stamps that are not quite even.
        period = 1 / self._parameters.rate_hz
        due = self._published + period
        if self._estimate.map_from_odom is None or now < due - 5e-4:
            return
        # Counted from when it was due: odometry that comes a little early or late does not halve the rate.
        self._published = due if now - due < period else now
        self._publish(now, odom_from_base, is_initial=False)

    def _publish(self, now: float, odom_from_base: Pose, is_initial: bool) -> None:
        known = self._estimate.map_from_odom
        assert known is not None
        map_from_base = known @ odom_from_base
        if self._parameters.planar:
            map_from_base = map_from_base.flat
            known = (map_from_base @ odom_from_base.inverse()).flat
        self._outlet.send_pose(now, map_from_base, self._estimate.spread_at(self._travel), is_initial)
        if self._parameters.publish_tf and not is_initial:
            self._outlet.send_transform(now + self._parameters.tf_tolerance_s, known)

    def _say(self, text: str) -> None:
        """Warn, but of what lasts only once."""
        if text != self._said:
            self._said = text
            self._outlet.warning(text)
