"""Which worker scores which map."""

from hypothesis import given
from hypothesis import strategies as st

from panoloc.service.jobs import MapRef
from panoloc.service.pool.shares import shares_of

MAPS = st.lists(st.uuids(), unique=True).map(lambda names: [MapRef(str(name), 1) for name in names])


@given(MAPS, st.integers(1, 9))
def test_every_map_is_in_one_share_and_moves_to_a_new_one_alone(maps: list[MapRef], num_shares: int) -> None:
    before, after = shares_of(maps, num_shares), shares_of(maps, num_shares + 1)
    assert sorted((ref for part in before.values() for ref in part), key=lambda ref: ref.id) == sorted(
        maps, key=lambda ref: ref.id
    )
    for number, part in before.items():
        assert set(part) <= {*after.get(number, ()), *after.get(num_shares, ())}


def test_shares_are_about_equal() -> None:
    sizes = [len(part) for part in shares_of([MapRef(f"map_{number}", 1) for number in range(3000)], 3).values()]
    assert len(sizes) == 3
    assert min(sizes) > 900
