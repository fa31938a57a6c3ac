from core.results import Hints
from service.worker.job_options import hints_of, index_options_of, scan_options_of

BOX = {"min": [0, 0, 0], "max": [4, 5, 2.5]}


def test_no_hints_are_no_hints() -> None:
    assert hints_of({}) is None
    assert hints_of({"hints": None}) is None
    assert hints_of({"hints": {"position_m": None, "radius_m": None}}) is None


def test_hints_arrive_as_the_algorithm_takes_them() -> None:
    hints = hints_of({"hints": {"position_m": [1, 2, 3], "radius_m": 5, "region": BOX, "upright": True}})
    assert hints == Hints(position_m=(1, 2, 3), radius_m=5, region=((0, 0, 0), (4, 5, 2.5)), upright=True)


def test_a_scan_is_read_as_its_uploader_said() -> None:
    options = scan_options_of({"unit": "mm", "up_axis": "y", "color_kind": "labels"}, "Floor 3.PLY", 5000, 1000)
    assert (options.unit, options.up_axis, options.color_kind) == ("mm", "y", "labels")
    assert options.format == "ply"
    assert (options.max_points_read, options.max_points) == (5000, 1000)


def test_starts_on_a_grid_in_a_region() -> None:
    options = index_options_of({"starts": {"method": "grid", "spacing_m": 1.0, "region": BOX}})
    assert (options.starts_method, options.spacing_m, options.region) == ("grid", 1.0, ((0, 0, 0), (4, 5, 2.5)))


def test_without_options_a_map_gets_octree_starts() -> None:
    options = index_options_of({})
    assert (options.starts_method, options.spacing_m, options.region) == ("octree", None, None)
