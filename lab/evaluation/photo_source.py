"""Any source of panoramas as a source of photos: cut out of the panoramas by the cameras of the suites.

A panorama has one centre, so frames of a session have no parallax here, whatever their recipe says; their tracking has its noise.
"""

import io
import zlib
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from PIL import Image

from panoloc.core.camera.rig import Panorama, Rig
from panoloc.core.errors import OptionsError
from panoloc.core.geometry.pose import Pose
from panoloc.core.image.reader import read_panorama
from panoloc.lab.evaluation.known_cases import KnownQuery, LoadedScan, ScanCases
from panoloc.lab.rooms import CAMERAS, QueryCamera, cut_photo, with_any_defect


def as_photos(scans: Sequence[ScanCases], camera: str, seeds: Sequence[int], width: int = 1024) -> list[ScanCases]:
    """Return the scans with photos in place of their panoramas; nothing is read before it is loaded.

    camera: one of `panoloc.lab.rooms.CAMERAS`. seeds: of headings and noise, one per panorama in turn. width: of a
    photo, pixels. Raises OptionsError for an unknown camera.
    """
    if camera not in CAMERAS:
        raise OptionsError(f"camera: expected one of {', '.join(CAMERAS)}, got {camera!r}")
    return [_photographed(scan, camera, seeds, width) for scan in scans]


def _photographed(scan: ScanCases, camera: str, seeds: Sequence[int], width: int) -> ScanCases:
    drawn = {
        f"{name}@{seeds[number % len(seeds)]}": (name, seeds[number % len(seeds)])
        for number, name in enumerate(scan.query_names)
    }

    def load() -> LoadedScan:
        """Load the scan, whose queries are cut when asked for."""
        loaded = scan.load()

        def query(name: str) -> KnownQuery:
            """Read the panorama and cut its photos."""
            of, seed = drawn[name]
            # By its name: the same photo whichever tags and limits chose the panorama.
            rng = np.random.default_rng((seed, zlib.crc32(of.encode()), 29))
            return cut_query(loaded.query(of), CAMERAS[camera], rng, width)

        return replace(loaded, query=query)

    return replace(
        scan,
        name=f"{scan.name}/{camera}" + (f"-{width}px" if width != 1024 else ""),
        group=f"{scan.group}/{camera}",
        query_names=tuple(drawn),
        load=load,
    )


def cut_query(known: KnownQuery, camera: QueryCamera, rng: np.random.Generator, width: int) -> KnownQuery:
    """Return the query of photos that the camera takes where a panorama was taken, in directions of its own; or the panorama, spoilt."""
    place = known.poses[0]
    if camera.shooting is None:
        panorama, missing = with_any_defect(known.panorama, rng)
        masked = Panorama(panorama.color, panorama.valid & ~missing)
        spoilt = Rig.of_panorama(masked if camera.masked else as_uploaded(panorama))
        return replace(known, query=spoilt, changed_pixels=None)
    lens, rotations = camera.shooting.camera(rng, width), camera.shooting.rotations(rng)
    photos = [cut_photo(known.panorama, lens, place.rotation.T @ rotation) for rotation in rotations]
    poses = [Pose(rotation, place.position) for rotation in rotations]
    session, _ = camera.rig_of(photos, poses, rng)
    # Where the place exists twice, the photo was turned against each of its panoramas alike.
    first = tuple(Pose(pose.rotation @ place.rotation.T @ rotations[0], pose.position) for pose in known.poses)
    return replace(known, query=session, poses=first, changed_pixels=None, hints=camera.hints)


def as_uploaded(panorama: Panorama) -> Panorama:
    """Return the panorama as it is read from a file without a mask, which may find what is missing; what was masked stays so."""
    buffer = io.BytesIO()
    Image.fromarray(panorama.color).save(buffer, "PNG")
    read = read_panorama(buffer.getvalue())
    return Panorama(read.color, read.valid & panorama.valid)
