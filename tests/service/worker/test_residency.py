from dataclasses import dataclass

import pytest

from panoloc.service.worker.residency import Residency


@dataclass(frozen=True)
class Blob:
    num_bytes: int


@pytest.mark.parametrize(
    ("max_bytes", "last", "held", "num_bytes"),
    [
        (25, 10, "ac", 20),  # `a` was used after `b`
        (30, 25, "c", 25),  # as many go as the newcomer needs
        (30, 31, "ab", 20),  # larger than the whole cache
    ],
)
def test_the_least_recently_used_make_room(max_bytes: int, last: int, held: str, num_bytes: int) -> None:
    residency: Residency[str, Blob] = Residency(max_bytes)
    for name in "ab":
        residency.put(name, Blob(10))
    assert residency.get("a") == Blob(10)
    residency.put("c", Blob(last))
    assert "".join(name for name in "abc" if residency.get(name)) == held
    assert residency.num_bytes == num_bytes
