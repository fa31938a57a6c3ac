"""Cases on disk: a scan, panoramas and a truth.json with their poses, as other tools read them."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from PIL import Image

from panoloc.core.camera.rig import Panorama
from panoloc.core.geometry.pose import Pose
from panoloc.core.scan.ply.writer import write_ply
from panoloc.core.scan.point_cloud import PointCloud

_CONVENTION = "x_map = rotation @ x_camera + position_m; camera: x forward (image centre), y left, z up"


@dataclass(frozen=True, eq=False)
class PosedPanorama:
    """A panorama with its pose; name becomes the file's name without ending; tags describe it."""

    name: str
    panorama: Panorama
    pose: Pose
    tags: tuple[str, ...] = ()


def write_case_folder(
    folder: Path,
    name: str,
    cloud: PointCloud,
    queries: Sequence[PosedPanorama],
    *,
    color_kind: str = "rgb",
) -> Path:
    """Write scan.ply, one image per query (JPEG, or PNG for labels) and truth.json; return the path of truth.json."""
    folder.mkdir(parents=True, exist_ok=True)
    write_ply(folder / "scan.ply", cloud)
    entries: list[dict[str, Any]] = []
    for query in queries:
        ending = "png" if color_kind == "labels" else "jpg"
        Image.fromarray(query.panorama.color).save(folder / f"{query.name}.{ending}", quality=92)
        entries.append(
            {
                "image": f"{query.name}.{ending}",
                "position_m": query.pose.position.tolist(),
                "rotation": query.pose.rotation.tolist(),
                "tags": list(query.tags),
            }
        )
    truth = {
        "name": name,
        "source": "procedural scene",
        "licence": "Apache-2.0",
        "convention": _CONVENTION,
        "color_kind": color_kind,
        "scans": ["scan.ply"],
        "queries": entries,
    }
    path = folder / "truth.json"
    path.write_text(json.dumps(truth, indent=1) + "\n")
    return path
