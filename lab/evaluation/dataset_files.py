"""What the readers of the data sets share: poses in text files, panoramas beside them, and messages when something is missing."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from core.errors import OptionsError
from core.geometry.pose import Pose
from core.panorama.panorama import Panorama
from core.panorama.reader import read_panorama
from lab.evaluation.known_cases import SourceError

IMAGE_ENDINGS = (".jpg", ".jpeg", ".png", ".webp")


def camera_from_map_pose(path: Path) -> Pose:
    """Return map_from_camera of a text file with [R | position], 3 x 4 or 4 x 4, where x_camera = R (x_map − position).

    That is the convention of the paper's reference implementation, whose camera axes are x forward, y left, z up as here.
    Raises SourceError when the file is missing or holds something else.
    """
    try:
        matrix = np.loadtxt(path, dtype=np.float64, ndmin=2)
    except (OSError, ValueError) as error:
        raise SourceError(
            f"{path}: expected a text file with a 3 x 4 or 4 x 4 matrix [R | position] ({error})"
        ) from error
    if matrix.shape not in ((3, 4), (4, 4)):
        raise SourceError(f"{path}: expected a 3 x 4 or 4 x 4 matrix [R | position], got {matrix.shape}")
    return pose_of(matrix[:3, :3].T, matrix[:3, 3], path)


def pose_of(rotation: NDArray[np.float64], position: NDArray[np.float64], path: Path) -> Pose:
    """Return a pose after checking that `rotation` is one; raises SourceError that names `path`."""
    is_rotation = np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-3) and np.linalg.det(rotation) > 0
    if not is_rotation or not np.isfinite(position).all():
        raise SourceError(f"{path}: expected an orthonormal right-handed rotation and a finite position")
    return Pose(rotation, position)


def images_in(folder: Path) -> tuple[str, ...]:
    """Return the names of the images of a folder, sorted."""
    return tuple(sorted(path.name for path in folder.iterdir() if path.suffix.lower() in IMAGE_ENDINGS))


def read_image(path: Path) -> Panorama:
    """Read a panorama file."""
    return read_panorama(path.read_bytes())


def without_black_poles(panorama: Panorama) -> Panorama:
    """Return the panorama with the rows that are black from a pole on marked as missing: scanners do not see straight up and down."""
    dark = panorama.color.max(axis=(1, 2)) == 0
    missing = np.logical_and.accumulate(dark) | np.logical_and.accumulate(dark[::-1])[::-1]
    if missing.all():
        return panorama
    return Panorama(panorama.color, panorama.valid & ~missing[:, None])


def chosen(split: str | None, known: tuple[str, ...], dataset: str) -> tuple[str, ...]:
    """Return the splits to read: `split`, or all; raises OptionsError for an unknown one."""
    if split is None:
        return known
    if split not in known:
        raise OptionsError(f"split: {dataset} has {', '.join(known) or 'none here'}; got {split!r}")
    return (split,)
