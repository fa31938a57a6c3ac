from collections.abc import Callable
from dataclasses import dataclass

from service.worker.residency import Residency


@dataclass(frozen=True)
class Blob:
    name: str
    num_bytes: int


def loader(name: str, num_bytes: int, log: list[str]) -> Callable[[], Blob]:
    def load() -> Blob:
        log.append(name)
        return Blob(name, num_bytes)

    return load


def test_what_is_held_is_not_loaded_again() -> None:
    log: list[str] = []
    residency: Residency[str, Blob] = Residency(100)
    first = residency.get_or_load("a", loader("a", 10, log))
    assert residency.get_or_load("a", loader("a", 10, log)) is first
    assert log == ["a"]


def test_the_least_recently_used_goes_first() -> None:
    log: list[str] = []
    residency: Residency[str, Blob] = Residency(25)
    for name in ("a", "b", "a", "c"):
        residency.get_or_load(name, loader(name, 10, log))
    assert "a" in residency
    assert "b" not in residency
    assert residency.num_bytes == 20


def test_as_many_go_as_the_newcomer_needs_room() -> None:
    log: list[str] = []
    residency: Residency[str, Blob] = Residency(30)
    for name in ("a", "b", "c"):
        residency.get_or_load(name, loader(name, 10, log))
    residency.get_or_load("large", loader("large", 25, log))
    assert [name for name in ("a", "b", "c", "large") if name in residency] == ["large"]
    assert residency.num_bytes == 25


def test_a_value_larger_than_the_cache_is_used_but_not_kept() -> None:
    residency: Residency[str, Blob] = Residency(30)
    residency.get_or_load("a", lambda: Blob("a", 10))
    assert residency.get_or_load("huge", lambda: Blob("huge", 31)).name == "huge"
    assert "huge" not in residency
    assert "a" in residency
