"""What rows say of a query: which camera took it, how much of the sphere it shows, and what the call knew of its orientation."""

from typing import Any

import numpy as np

from core.camera.lens import project_to_image
from core.geometry.rotations import even_directions
from core.panorama.panorama import Panorama
from core.panorama.session import Session
from lab.evaluation.known_cases import KnownQuery

_NUM_DIRECTIONS = 4000


def query_facts(query: KnownQuery) -> dict[str, Any]:
    """Return `camera`, `num_images`, `hfov_deg` of the first image, `coverage` (share of the sphere, 0..1), and `upright`.

    upright: "hint" where the camera is said to be level, "session" where the session knows its up axis, else None.
    """
    said = query.query
    known = "hint" if query.hints is not None and query.hints.upright else None
    if isinstance(said, Panorama):
        whole = {"camera": "panorama", "num_images": 1, "hfov_deg": 360.0}
        return {**whole, "coverage": round(panorama_coverage(said), 4), "upright": known}
    camera = said.images[0].photo.camera
    return {
        "camera": camera.model,
        "num_images": len(said.images),
        "hfov_deg": round(camera.hfov_deg, 1),
        "coverage": round(session_coverage(said), 4),
        "upright": known or ("session" if said.options.up_known else None),
    }


def panorama_coverage(panorama: Panorama) -> float:
    """Return which share of the sphere is valid."""
    height = len(panorama.valid)
    weights = np.sin(np.pi * (np.arange(height) + 0.5) / height)
    return float((panorama.valid.mean(1) * weights).sum() / weights.sum())


def session_coverage(session: Session) -> float:
    """Return which share of the sphere the photos show together, as if all had been taken from one place."""
    directions = even_directions(_NUM_DIRECTIONS).double().numpy()
    covered = np.zeros(len(directions), np.bool_)
    for image in session.images:
        u, v, shown = project_to_image(image.photo.camera, directions @ image.session_from_camera.rotation)
        height, width = image.photo.valid.shape
        row = np.minimum(v[shown].astype(int), height - 1)
        column = np.minimum(u[shown].astype(int), width - 1)
        covered[np.flatnonzero(shown)[image.photo.valid[row, column]]] = True
    return float(covered.mean())
