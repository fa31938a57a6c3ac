from pathlib import Path

import pytest

from service.host.cpu_share import num_sockets, num_usable_cpus


@pytest.mark.parametrize(("limit", "expected"), [("50000 100000", 1), ("100 100000", 1), ("100000 100000", 1)])
def test_a_container_quota_bounds_the_processors(tmp_path: Path, limit: str, expected: int) -> None:
    file = tmp_path / "cpu.max"
    file.write_text(limit)
    assert num_usable_cpus(file) == expected


def test_without_a_quota_all_allowed_processors_count(tmp_path: Path) -> None:
    file = tmp_path / "cpu.max"
    file.write_text("max 100000")
    assert num_usable_cpus(file) == num_usable_cpus(tmp_path / "absent") >= 1


def test_processors_of_one_package_are_one_socket(tmp_path: Path) -> None:
    for cpu, package in enumerate(["0", "0", "1", "1"]):
        topology = tmp_path / f"cpu{cpu}" / "topology"
        topology.mkdir(parents=True)
        (topology / "physical_package_id").write_text(package + "\n")
    assert num_sockets(tmp_path) == 2
    assert num_sockets(tmp_path / "absent") == 1
