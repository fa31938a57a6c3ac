"""How the console copes with a large scan: time to the first picture and to all points, frames per second while it is turned, memory.

python -m lab.console.large_scan [MILLIONS]    10 unless another number is given
"""

import json
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from playwright.sync_api import Page

from core.scan.ply.writer import encode_ply
from core.scan.point_cloud import PointCloud
from lab.console.page import open_page, scene_state
from lab.own_service import OwnService, own_service
from lab.rooms import SceneSpec, build_scene, scan_scene

_ROOM_POINTS = 40_000
_DENSE_POINTS = 1_000_000
_JITTER_M = 0.005
_PATIENCE_S = 120.0
_TURNING_S = 3.0


def large_map(service: OwnService, num_points: int) -> str:
    """Register a room, and put so many points in the place of its stored sample: no computation is part of the measurement."""
    room = build_scene(SceneSpec(kind="room", seed=5, area_m2=40))
    scan = service.folder / "room.ply"
    scan.write_bytes(encode_ply(scan_scene(room, num_points=_ROOM_POINTS)))
    map_id = str(service.client.register_map(scan, {"starts": {"method": "grid", "spacing_m": 1.0}})["id"])
    while service.client.get_map(map_id)["status"] != "ready":
        time.sleep(0.5)
    stored = service.data_dir / "maps" / map_id / "1" / "points.ply"
    stored.with_name("points.ply.sha256").unlink()
    stored.write_bytes(_many(scan_scene(room, num_points=_DENSE_POINTS), num_points))
    return map_id


def _many(cloud: PointCloud, num_points: int) -> bytes:
    rng = np.random.default_rng(0)
    chosen = rng.integers(0, len(cloud), num_points)
    positions = cloud.positions[chosen] + rng.normal(0, _JITTER_M, (num_points, 3)).astype(np.float32)
    return encode_ply(PointCloud(positions, cloud.colors[chosen]))


def measure(page: Page, url: str, num_points: int) -> dict[str, Any]:
    """Open a map's page, and turn the scan once it is all there."""
    began = time.monotonic()
    page.goto(url)
    first_s = _seconds_until(page, began, lambda state: state.get("numDrawn", 0) > 0)
    all_s = _seconds_until(page, began, lambda state: bool(state.get("isStill")) and state["numPoints"] >= num_points)
    pictures_per_ms = page.evaluate(
        f"""async () => {{
            const {{ stage }} = document.querySelector('canvas[data-scene]');
            const began = performance.now();
            let pictures = 0;
            for (; performance.now() - began < 1000 * {_TURNING_S}; pictures += 1) {{
                stage.spin(2);
                await new Promise((next) => requestAnimationFrame(next));
            }}
            return pictures / (performance.now() - began);
        }}"""
    )
    turning = scene_state(page)
    memory = page.evaluate("performance.memory.usedJSHeapSize")
    return {
        "first_picture_s": round(first_s, 2),
        "all_points_s": round(all_s, 2),
        "frames_per_s": round(1000 * pictures_per_ms, 1),
        "points_per_frame": turning["numDrawn"],
        "num_points": turning["numPoints"],
        "script_heap_mb": round(memory / 1e6),
        "renderer": turning["renderer"],
    }


def _seconds_until(page: Page, began: float, holds: Callable[[dict[str, Any]], bool]) -> float:
    while not holds(scene_state(page)):
        if time.monotonic() - began > _PATIENCE_S:
            raise TimeoutError(f"not within {_PATIENCE_S:g} s: {scene_state(page)}")
        time.sleep(0.02)
    return time.monotonic() - began


def main(millions: float) -> None:
    """Print the figures as JSON."""
    with own_service() as service, open_page(viewport={"width": 1440, "height": 900}) as page:
        num_points = int(millions * 1e6)
        map_id = large_map(service, num_points)
        print(json.dumps(measure(page, f"{service.url}/#/maps/{map_id}", num_points), indent=2))


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 10.0)
