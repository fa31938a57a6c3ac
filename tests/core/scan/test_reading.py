"""What is checked, converted and said whatever the format is."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from panoloc.core.errors import OptionsError, ScanContentError
from panoloc.core.options import ScanOptions
from panoloc.core.scan.ply.writer import encode_ply
from panoloc.core.scan.point_cloud import PointCloud
from panoloc.core.scan.reading import read_scan
from tests.core.scan.scan_files import CLOUD, codes_of, put, read


class WithdrawnError(Exception):
    """What a caller may raise who no longer wants the work."""


def text_scan(positions: np.ndarray, color: str = "10 200 30") -> str:
    return "\n".join(f"{x!r} {y!r} {z!r} {color}" for x, y, z in positions.tolist()) + "\n"


ROOM = np.array([[0, 0, 0], [4, 3, 2.5], [1, 2, 0.5], [3.5, 0.25, 1.25]])


def test_points_that_are_not_finite_are_dropped_and_counted() -> None:
    positions = CLOUD.positions.copy()
    positions[[1, 5, 9], [0, 1, 2]] = [np.nan, np.inf, -np.inf]
    positions[11, 0] = 3e38
    found = read("scan.ply", encode_ply(PointCloud(positions, CLOUD.colors)))
    np.testing.assert_array_equal(found.positions, np.delete(CLOUD.positions, [1, 5, 9, 11], axis=0))
    assert codes_of(found) == ["non_finite_points"]
    assert "4 of 60 points were dropped" in found.diagnostics[0].message
    assert found.num_points_read == 60


@pytest.mark.parametrize(
    ("positions", "said"),
    [
        (np.full((5, 3), np.nan), "None of the 5 points"),
        (np.array([[1.0, 2.0, 3.0]]), "a single usable point"),
        (np.array([[1.0, 2.0, 3.0], [np.nan, 0, 0]]), "a single usable point"),
        (np.full((5, 3), 2.0), "same position"),
    ],
)
def test_a_scan_without_extent_or_finite_points_is_refused(positions: np.ndarray, said: str) -> None:
    colors = np.full((len(positions), 3), 99, np.uint8)
    with pytest.raises(ScanContentError, match=said):
        read("scan.ply", encode_ply(PointCloud(positions.astype(np.float32), colors)))


def test_colours_that_are_all_zero_are_refused() -> None:
    with pytest.raises(ScanContentError, match=r"colour \(0, 0, 0\)"):
        read("scan.ply", encode_ply(PointCloud(CLOUD.positions, np.zeros_like(CLOUD.colors))))


@pytest.mark.parametrize(
    ("color", "expected", "noted"),
    [
        ("0.2 1 0", (51, 255, 0), ["color_range"]),
        ("51 255 0", (51, 255, 0), []),
        ("2 6 0", (2, 6, 0), ["dark_colors"]),
        ("13107 65535 0", (51, 255, 0), ["color_range"]),
    ],
)
def test_colour_ranges_are_found_and_said(color: str, expected: tuple[int, int, int], noted: list[str]) -> None:
    found = read("scan.xyz", text_scan(ROOM, color))
    assert (found.colors == expected).all()
    assert codes_of(found) == noted


@pytest.mark.parametrize("color", ["-20 10 10", "1 2 70000"])
def test_colours_in_no_known_range_are_refused(color: str) -> None:
    header = "x y z r g b\n"
    with pytest.raises(ScanContentError, match=r"expected 0\.\.1, 0\.\.255 or 0\.\.65535"):
        read("scan.xyz", header + text_scan(ROOM, color))


@pytest.mark.parametrize(("unit", "metres"), [("m", 1.0), ("cm", 0.01), ("mm", 0.001), ("ft", 0.3048)])
def test_units_become_metres(unit: str, metres: float) -> None:
    found = read("scan.xyz", text_scan(ROOM / metres), unit=unit)
    np.testing.assert_allclose(found.positions, ROOM, atol=1e-6)
    assert codes_of(found) == ([] if unit == "m" else ["unit_converted"])


def test_y_up_becomes_z_up_and_stays_right_handed() -> None:
    found = read("scan.xyz", text_scan(ROOM), up_axis="y")
    x, y, z = ROOM.T
    np.testing.assert_allclose(found.positions, np.stack([x, -z, y], axis=1), atol=1e-6)
    assert codes_of(found) == ["axes_converted"]


def test_large_coordinates_lose_nothing_to_float32() -> None:
    origin = np.array([691_000.1234, 5_335_000.5678, 520.0])
    found = read("scan.xyz", text_scan(ROOM + origin))
    np.testing.assert_allclose(found.positions + found.origin_offset, ROOM + origin, atol=1e-6, rtol=0)
    np.testing.assert_array_equal(found.origin_offset, np.rint(found.origin_offset))
    assert codes_of(found) == ["large_coordinates"]


@pytest.mark.parametrize("num_strays", [1, 90])
def test_null_points_far_from_a_scan_cost_it_no_millimetre(num_strays: int) -> None:
    origin = np.array([691_000.1234, 5_335_000.5678, 520.0])
    room = np.random.default_rng(1).random((200, 3)) * 5 + origin
    found = read("scan.xyz", text_scan(np.vstack([room, np.zeros((num_strays, 3))])))
    np.testing.assert_allclose(found.positions + found.origin_offset, room, atol=1e-6, rtol=0)
    assert codes_of(found) == ["stray_points", "large_coordinates"]
    assert (
        f"{num_strays} of {200 + num_strays} points were left out, the first of them at (0, 0, 0)"
        in found.diagnostics[0].message
    )


@pytest.mark.parametrize(("num_far", "apart_m"), [(20, 5000.0), (1, 1500.0)])
def test_what_is_a_part_of_a_scan_is_no_stray(num_far: int, apart_m: float) -> None:
    room = np.random.default_rng(1).random((200, 3)) * 5
    room[:num_far, 0] += apart_m
    assert len(read("scan.xyz", text_scan(room)).positions) == 200


@pytest.mark.parametrize("factor", [1000, 0.001])
def test_a_room_of_four_kilometres_or_four_millimetres_makes_one_ask_for_the_unit(factor: float) -> None:
    found = read("scan.xyz", text_scan(ROOM * factor))
    note = next(note for note in found.diagnostics if note.code == "suspicious_extent")
    assert note.severity == "warning"
    assert "check the unit" in note.message


@pytest.mark.slow
def test_progress_rises_from_zero_to_one(tmp_path: Path) -> None:
    text = text_scan(np.random.default_rng(0).random((150_000, 3)))
    seen: list[float] = []
    read_scan(put(tmp_path, "scan.xyz", text), progress=seen.append)
    assert seen == sorted(seen)
    assert (seen[0], seen[-1]) == (0.0, 1.0)
    assert len(seen) >= 4


def test_what_the_progress_callback_raises_passes_through(tmp_path: Path) -> None:
    def cancel(fraction: float) -> None:
        if fraction > 0:
            raise WithdrawnError("withdrawn")

    with pytest.raises(WithdrawnError, match="withdrawn"):
        read_scan(put(tmp_path, "scan.ply", encode_ply(CLOUD)), progress=cancel)


@pytest.mark.parametrize(
    "wrong", [{"unit": "inch"}, {"up_axis": "w"}, {"color_kind": "gray"}, {"max_points_used": 0}, {"max_points": -1}]
)
def test_options_out_of_their_range_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(OptionsError, match=next(iter(wrong))):
        ScanOptions(**wrong)  # type: ignore[arg-type]


def test_reading_a_ply_imports_no_heavy_library(tmp_path: Path) -> None:
    path = put(tmp_path, "scan.ply", encode_ply(CLOUD))
    program = (
        "import sys; from pathlib import Path; from panoloc.core.scan.reading import read_scan; read_scan(Path(sys.argv[1])); "
        "print(sorted({'open3d', 'torch', 'laspy', 'pye57'} & set(sys.modules)))"
    )
    root = Path(__file__).parents[3]
    done = subprocess.run([sys.executable, "-c", program, path], cwd=root, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
