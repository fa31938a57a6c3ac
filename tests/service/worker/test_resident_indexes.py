from types import SimpleNamespace
from typing import cast

import pytest

from panoloc.core.map.map_index import MapIndex
from panoloc.service.jobs import MapRef
from panoloc.service.worker.shelf import Resident


def index(num_bytes: int) -> MapIndex:
    return cast(MapIndex, SimpleNamespace(num_bytes=num_bytes))


@pytest.mark.parametrize(
    ("max_bytes", "last", "held", "num_bytes"),
    [
        (25, 10, "ac", 20),  # `a` was used after `b`
        (30, 25, "c", 25),  # as many go as the newcomer needs
        (30, 31, "ab", 20),  # larger than all room
    ],
)
def test_the_least_recently_used_make_room(max_bytes: int, last: int, held: str, num_bytes: int) -> None:
    resident: Resident[MapIndex] = Resident(max_bytes)
    for name in "ab":
        resident.put(MapRef(name, 1), index(10))
    assert resident.get(MapRef("a", 1)) == index(10)
    resident.put(MapRef("c", 1), index(last))
    assert "".join(name for name in "abc" if resident.get(MapRef(name, 1))) == held
    assert resident.num_bytes == num_bytes
