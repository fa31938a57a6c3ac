"""A phone in a browser: its camera shows a room from a known place, its sensors say how it is turned."""

import math
import re
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from playwright.sync_api import Browser, CDPSession, Page, expect

from panoloc.core.camera.camera import Camera
from panoloc.core.geometry.pose import Pose
from panoloc.lab.rooms import Scene, take_photo
from panoloc.lab.rooms.capture.shooting import turned
from tests.integration.console_page import browser, page_of

SIZE = (540, 960)
SCREEN = {"width": 390, "height": 844}
_HEADER = b"YUV4MPEG2 W%d H%d F10:1 Ip A1:1 C420\n" % SIZE
# Until the browser has read the picture anew.
_FRAMES_MS = 450
_STEP_DEG = 45.0
_END = re.compile("You are here|Probably here|Not found|Several places fit")


@dataclass(frozen=True)
class Hand:
    """Somebody who stands in a room and holds a phone. stand: (3,), of the axis to turn about. longer_hfov_deg: of the camera."""

    scene: Scene
    stand: NDArray[np.float64]
    yaw_deg: float
    pitch_deg: float = 0.0
    arm_m: float = 0.35
    longer_hfov_deg: float = 69.0

    def pose(self, turned_deg: float) -> Pose:
        """Return map_from_camera after a turn to the left."""
        rotation = turned(math.radians(self.yaw_deg + turned_deg), math.radians(self.pitch_deg), 0.0)
        return Pose(rotation, self.stand + self.arm_m * rotation[:, 0] * (1, 1, 0))

    def photo(self, turned_deg: float) -> NDArray[np.uint8]:
        """Return what the camera sees (H, W, 3)."""
        tangent = math.tan(math.radians(self.longer_hfov_deg) / 2) * SIZE[0] / SIZE[1]
        camera = Camera.from_hfov("pinhole", *SIZE, math.degrees(2 * math.atan(tangent)))
        return take_photo(self.scene, camera, self.pose(turned_deg)).photo.color


class Phone:
    """The page of a map in a browser, and what the phone sees and feels."""

    def __init__(self, page: Page, camera: Path) -> None:
        self.page = page
        self._camera = camera
        self._devtools: CDPSession = page.context.new_cdp_session(page)

    def hold(self, hand: Hand, turned_deg: float) -> None:
        """Show what the camera sees then, and after that say how the phone is turned."""
        with self._camera.open("r+b") as file:
            file.write(_video(hand.photo(turned_deg)))
        self.page.wait_for_timeout(_FRAMES_MS)
        # Sensors count from any direction.
        turn = {"alpha": (hand.yaw_deg + turned_deg + 77) % 360, "beta": 90 - hand.pitch_deg, "gamma": 0}
        self._devtools.send("DeviceOrientation.setDeviceOrientationOverride", turn)

    def find(self, hand: Hand) -> "Found":
        """Take a picture, turn while the page asks for it, and return what it says in the end."""
        page = self.page
        self.hold(hand, 0)
        page.get_by_role("button", name=re.compile("Find where I am|Look again")).click()
        began = time.monotonic()
        page.get_by_role("button", name="Take a picture").click()
        num_shots, in_turning_s = 1, 0.0
        end, more = page.get_by_role("heading", name=_END), page.get_by_text("Not sure yet")
        while True:
            expect(end.or_(more).first).to_be_visible()
            if end.count():
                break
            at = time.monotonic()
            self.hold(hand, _STEP_DEG * num_shots)
            num_shots += 1
            expect(page.get_by_text(f"Picture {num_shots} of").or_(end).first).to_be_visible()
            in_turning_s += time.monotonic() - at
            page.wait_for_timeout(300)
        seconds = time.monotonic() - began - in_turning_s
        title = str(end.inner_text())
        said = page.locator("[data-picture]")
        if not said.count():
            return Found(title, num_shots, seconds, math.inf)
        x, y = map(float, re.findall(r"[xy] (-?[\d.]+) m", said.inner_text()))
        num_shots = int(str(said.get_attribute("data-picture")))
        truth = hand.pose(_STEP_DEG * (num_shots - 1)).position
        return Found(title, num_shots, seconds, math.dist((x, y), truth[:2]))


@dataclass(frozen=True)
class Found:
    """title: what the page says. num_shots: that its answer is about. seconds: without those that turning took.
    error_m: on the plan, infinite without a place."""

    title: str
    num_shots: int
    seconds: float
    error_m: float
    num_tries: int = 1

    @property
    def is_sure(self) -> bool:
        """Return whether the page says that this is the place."""
        return self.title == "You are here"


@dataclass(frozen=True)
class CameraBrowser:
    """A browser whose camera shows the picture in a file, a video of one frame."""

    chromium: Browser
    camera: Path


@contextmanager
def camera_browser() -> Iterator[CameraBrowser]:
    """Start one."""
    with tempfile.TemporaryDirectory() as folder:
        camera = Path(folder) / "camera.y4m"
        camera.write_bytes(_video(np.zeros((SIZE[1], SIZE[0], 3), np.uint8)))
        arguments = [
            "--use-fake-ui-for-media-stream",
            "--use-fake-device-for-media-stream",
            f"--use-file-for-fake-video-capture={camera}",
        ]
        with browser(*arguments) as chromium:
            yield CameraBrowser(chromium, camera)


@contextmanager
def phone_at(url: str, through: CameraBrowser, **context: object) -> Iterator[Phone]:
    """Open the page on a phone that has a camera."""
    screen = {"viewport": SCREEN, "has_touch": True, "is_mobile": True}
    with page_of(through.chromium, url, **{**screen, **context}) as page:
        yield Phone(page, through.camera)


def _video(picture: NDArray[np.uint8]) -> bytes:
    """Return a picture (H, W, 3) as a video of one frame: YUV 4:2:0 of the range that videos have."""
    height, width = picture.shape[:2]
    planes = Image.fromarray(picture).convert("YCbCr").split()
    luma = 16 + np.asarray(planes[0], np.float32) * 219 / 255
    chroma = [
        128 + (np.asarray(plane.resize((width // 2, height // 2), Image.Resampling.BOX), np.float32) - 128) * 224 / 255
        for plane in planes[1:]
    ]
    return _HEADER + b"FRAME\n" + b"".join(np.rint(plane).astype(np.uint8).tobytes() for plane in (luma, *chroma))
