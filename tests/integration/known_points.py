"""Points on the true surfaces of a scene, in sight and in the middle of a pixel: known places for clicks, which no scan has to say."""

import json
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from playwright.sync_api import Page

from panoloc.lab.rooms import Scene

Points = NDArray[np.float64]

_NUM_RAYS = 20_000
# Around a point its surface is flat so far: what a click hits is a piece of it.
_FLAT_M = 0.14
_OFF_PIXEL, _OFF_PLANE_M, _APART_M = 0.12, 0.001, 0.5
# As text: Playwright takes and gives numbers one by one, which takes seconds for so many.
_PROJECT = """points => {
    const { stage } = document.querySelector('canvas[data-scene]');
    return JSON.stringify(JSON.parse(points).map(point => stage.project(point) ?? [-1, -1]));
}"""


def seen_from_above(low: Points, high: Points) -> tuple[Points, Points]:
    """Return rays, origins and directions (N, 3), straight down from a section. low, high: corners (3,) of what lies below it."""
    origins = np.random.default_rng(0).uniform(low, high, (_NUM_RAYS, 3))
    origins[:, 2] = high[2]
    return origins, np.tile([0.0, 0.0, -1.0], (_NUM_RAYS, 1))


def seen_from(eye: Points) -> tuple[Points, Points]:
    """Return rays, origins and directions (N, 3), from a camera to all sides."""
    directions = np.random.default_rng(0).normal(size=(_NUM_RAYS, 3))
    return np.tile(eye, (_NUM_RAYS, 1)), directions / np.linalg.norm(directions, axis=1, keepdims=True)


def known_points(page: Page, scene: Scene, origin: Points, rays: tuple[Points, Points]) -> Iterator[tuple[Points, Any]]:
    """Yield points (3,), each with the place on the page at which the 3D view shows it. origin: (3,) of the view's world."""
    origins, directions = rays
    points = _hits(scene, origins, directions)
    box = page.locator("canvas[data-scene]").bounding_box()
    assert box is not None
    projected = json.loads(page.evaluate(_PROJECT, json.dumps((points - origin).tolist())))
    pixels = np.array(projected) + np.array([box["x"], box["y"]])
    # Between the tools and the panels over the view.
    inside = (pixels > [60, 190]) & (pixels < [box["width"] - 340, box["y"] + box["height"] - 110])
    is_exact = (np.abs(pixels - pixels.round()).max(axis=1) < _OFF_PIXEL) & inside.all(axis=1)
    found: list[Points] = []
    for point, origin, direction, pixel in zip(
        points[is_exact], origins[is_exact], directions[is_exact], pixels[is_exact].round(), strict=True
    ):
        is_far = all(np.linalg.norm(point - other) > _APART_M for other in found)
        if is_far and _is_flat(scene, point, origin, direction):
            found.append(point)
            yield point, pixel.tolist()


def _hits(scene: Scene, origins: Points, directions: Points) -> Points:
    """Return where rays meet the scene, far away where they meet nothing."""
    distance = np.minimum(scene.surface.cast(origins, directions).distance, 1e3)[:, None]
    return np.asarray(origins + distance * directions, np.float64)


def _is_flat(scene: Scene, point: Points, origin: Points, direction: Points) -> bool:
    """Tell whether the rays beside one meet the same plane, not at a slant."""
    across = np.linalg.svd(direction[None])[2][1:]
    turns = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    beside = origin + _FLAT_M * (np.cos(turns)[:, None] * across[0] + np.sin(turns)[:, None] * across[1])
    around = _hits(scene, beside, np.tile(direction, (len(turns), 1))) - point
    if np.linalg.norm(around, axis=1).max() > 2 * _FLAT_M:
        return False
    normal = np.linalg.svd(around)[2][2]
    return bool(np.abs(around @ normal).max() < _OFF_PLANE_M)
