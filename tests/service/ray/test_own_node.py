"""How the service waits for a Ray of its own."""

import pytest

from service.ray.own_node import patient


def test_a_node_that_comes_late_is_waited_for() -> None:
    asked: list[tuple[str, str]] = []

    def ask(address: str, node_id: str) -> str:
        asked.append((address, node_id))
        if len(asked) < 3:
            raise RuntimeError("no node yet")
        return "node"

    assert patient(ask, 60.0)("127.0.0.1:1", node_id="2") == "node"
    assert asked == [("127.0.0.1:1", "2")] * 3


def test_one_that_never_comes_is_given_up() -> None:
    def ask() -> str:
        raise RuntimeError("no node yet")

    with pytest.raises(RuntimeError, match="no node yet"):
        patient(ask, 0.0)()
