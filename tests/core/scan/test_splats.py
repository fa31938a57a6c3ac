"""Gaussian splats are told from other PLY files by their fields; their centres become points."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from panoloc.core.errors import ScanContentError, ScanDamagedError
from panoloc.core.scan.point_cloud import PointCloud
from panoloc.core.scan.reading import read_scan
from tests.core.scan.splat_files import splat_ply

ScanFile = Callable[[str, bytes | str], Path]


def test_centres_of_opaque_splats_are_points_with_the_colour_of_the_constant_harmonic(
    cloud: PointCloud, scan_file: ScanFile
) -> None:
    opacities = np.where(np.arange(len(cloud)) % 3, 0.98, 0.2)
    read = read_scan(scan_file("splats.ply", splat_ply(cloud, opacities)))
    kept = opacities > 0.5
    np.testing.assert_array_equal(read.positions, cloud.positions[kept])
    np.testing.assert_array_equal(read.colors, cloud.colors[kept])
    note = next(note for note in read.diagnostics if note.code == "splats_read")
    assert f"{kept.sum()} of {len(cloud)}" in note.message


def test_haze_alone_is_no_scan(cloud: PointCloud, scan_file: ScanFile) -> None:
    with pytest.raises(ScanContentError, match=r"None of the 60 Gaussian splats has an opacity of 0\.5 or more"):
        read_scan(scan_file("splats.ply", splat_ply(cloud, np.full(len(cloud), 0.1))))


def test_splats_cut_short_are_damaged(cloud: PointCloud, scan_file: ScanFile) -> None:
    whole = splat_ply(cloud, np.full(len(cloud), 0.9))
    with pytest.raises(ScanDamagedError, match="enough for 59: the file is cut off"):
        read_scan(scan_file("splats.ply", whole[:-5]))


def test_packed_splats_are_told_what_to_export(scan_file: ScanFile) -> None:
    fields = "".join(f"property uint packed_{name}\n" for name in ("position", "rotation", "scale", "color"))
    text = f"ply\nformat binary_little_endian 1.0\nelement vertex 2\n{fields}end_header\n".encode() + bytes(32)
    with pytest.raises(ScanContentError, match=r"packed form\. Export them unpacked"):
        read_scan(scan_file("splats.ply", text))
