"""Whether a joined cluster answers is found out by its ports alone."""

import socket
from types import SimpleNamespace

from service.ray.contact import Contact
from tests.integration.running_service import free_port


def listening() -> tuple[socket.socket, int]:
    server = socket.create_server(("127.0.0.1", 0))
    return server, server.getsockname()[1]


def test_what_listens_is_not_silent_and_what_does_not_is_named_with_its_address() -> None:
    head, head_port = listening()
    node_port = free_port()
    with head:
        assert Contact((("head", "127.0.0.1", head_port),)).silent() is None
        silent = Contact((("head", "127.0.0.1", head_port), ("node", "127.0.0.1", node_port))).silent()
    assert silent is not None
    assert f"Ray's node does not answer at 127.0.0.1:{node_port}" in silent
    assert "head" in (Contact((("head", "127.0.0.1", head_port),)).silent() or "")


def test_a_connection_has_the_head_and_the_node_of_its_own_machine() -> None:
    context = SimpleNamespace(gcs_address="[::1]:6379", get_node_id=lambda: "b")
    nodes = [
        {"NodeID": name, "NodeManagerAddress": f"machine-{name}", "NodeManagerPort": port}
        for name, port in (("a", 1), ("b", 2))
    ]
    ray = SimpleNamespace(get_runtime_context=lambda: context, nodes=lambda: nodes)
    assert Contact.of_connection(ray).points == (("head", "::1", 6379), ("node of this machine", "machine-b", 2))
