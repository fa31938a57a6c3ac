"""A phone with AR in a browser: its session has an origin of its own, its camera shows a room from known places."""

import base64
import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from playwright.sync_api import Browser, Locator, Page

from panoloc.core.camera.camera import Camera
from panoloc.core.geometry.pose import Pose
from panoloc.lab.rooms import Scene, take_photo
from panoloc.lab.rooms.capture.shooting import turned
from tests.core.image.picture_files import encoded
from tests.integration.console_page import page_of
from tests.integration.phone import SCREEN, Hand
from tests.packaging.test_js_package import PACKAGE

_IWER = PACKAGE / "node_modules" / "iwer" / "build" / "iwer.min.js"
_FOVY_DEG = 75.0
_DEVICE = Path(__file__).with_name("ar_phone.js").read_text(encoding="utf-8")
_SESSION_FROM_MAP = Pose(turned(math.radians(40.0), 0.0, 0.0), np.array([0.7, -0.4, 0.2]))


class ArPhone:
    """The page of a map, and where the phone is held in the room."""

    def __init__(self, page: Page) -> None:
        self.page = page
        self._session_from_map = _SESSION_FROM_MAP
        self._photos: dict[bytes, str] = {}  # PNG by pose: the same places are held again after a reload

    def reload(self) -> None:
        """Come back another time: the next session has its origin elsewhere, turned."""
        self._session_from_map = self._session_from_map.after(_SESSION_FROM_MAP)
        self.page.reload()

    def hold(self, hand: Hand, turned_deg: float) -> None:
        """Move there, and let the camera see the room."""
        pose = hand.pose(turned_deg)
        in_session = self._session_from_map.after(pose).in_frame("webxr")
        seen = pose.matrix.tobytes()
        if seen not in self._photos:
            self._photos[seen] = _photo(hand.scene, pose)
        place = {
            "position": in_session.position.tolist(),
            "quaternion": in_session.quaternion_xyzw.tolist(),
        }
        self.page.evaluate(f"place => holdPhone(place, 'data:image/png;base64,{self._photos[seen]}')", place)

    def seen_direction(self, note: Locator, pose: Pose) -> NDArray[np.float64]:
        """Return the direction (3,) in the map in which a camera at that pose shows a note."""
        box = note.bounding_box()
        assert box is not None
        tangent = math.tan(math.radians(_FOVY_DEG) / 2) / (SCREEN["height"] / 2)
        right = (box["x"] + box["width"] / 2 - SCREEN["width"] / 2) * tangent
        down = (box["y"] + box["height"] / 2 - SCREEN["height"] / 2) * tangent
        direction = pose.rotation @ np.array([1, -right, -down])  # x forward, y left, z up
        return np.asarray(direction / np.linalg.norm(direction))


def _photo(scene: Scene, pose: Pose) -> str:
    """Return what the camera sees as PNG in base64."""
    size = (SCREEN["width"], SCREEN["height"])
    hfov_rad = 2 * math.atan(math.tan(math.radians(_FOVY_DEG) / 2) * size[0] / size[1])
    camera = Camera.from_hfov("pinhole", *size, math.degrees(hfov_rad))
    return base64.b64encode(encoded(take_photo(scene, camera, pose).photo.color, "PNG")).decode()


@contextmanager
def ar_phone_at(url: str, chromium: Browser) -> Iterator[ArPhone]:
    """Open the page on a phone whose browser offers AR."""
    with page_of(chromium, "about:blank", viewport=SCREEN, has_touch=True, is_mobile=True) as page:
        page.add_init_script(path=_IWER)
        page.add_init_script(_DEVICE.replace("FOVY_RAD", str(math.radians(_FOVY_DEG))))
        page.goto(url)
        yield ArPhone(page)
