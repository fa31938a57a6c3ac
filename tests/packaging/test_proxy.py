"""The proxy of docker/nginx before API replicas of ours: real nginx, a name server of ours."""

import http.server
import socket
import threading
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import httpx
import pytest

from tests.integration.proxy import NGINX, Proxy, missing_tool, proxy_of
from tests.integration.running_service import eventually, free_port

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(missing_tool() is not None, reason="scripts/install --dev installs nginx"),
]
HOME = "127.0.0.1"


class Replica:
    """Stands for an API replica: it answers, or dies with the request in its hands."""

    def __init__(self, address: str, port: int) -> None:
        self.bodies: list[bytes] = []
        self.is_dying = False
        replica = self

        class Handler(http.server.BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                replica.bodies.append(self.rfile.read(int(self.headers.get("Content-Length", 0))))
                if replica.is_dying:
                    self.connection.close()
                    return
                self.send_response(200)
                self.send_header("Content-Length", "0")
                self.end_headers()

            def do_GET(self) -> None:
                self.do_POST()

            def log_message(self, format: str, *args: object) -> None:
                """Say nothing."""

        class Server(http.server.ThreadingHTTPServer):
            def handle_error(self, request: object, client_address: object) -> None:
                """Die quietly."""

        self.server = Server((address, port), Handler)
        threading.Thread(target=self.server.serve_forever, daemon=True).start()

    def end(self) -> None:
        self.server.shutdown()
        self.server.server_close()


class Names:
    """A name server: every name has these addresses, or does not exist when there are none."""

    def __init__(self) -> None:
        self.addresses: list[str] = []
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind((HOME, 0))
        self.port = self.socket.getsockname()[1]
        threading.Thread(target=self._answer, daemon=True).start()

    def _answer(self) -> None:
        with suppress(OSError):  # of a socket that was closed, between a question and its answer as well
            while True:
                query, client = self.socket.recvfrom(512)
                question = query[12 : query.index(b"\0", 12) + 5]
                records = [
                    b"\xc0\x0c\x00\x01\x00\x01\x00\x00\x00\x01\x00\x04" + socket.inet_aton(each)
                    for each in self.addresses
                ]
                flags = b"\x81\x80" if records else b"\x81\x83"
                counts = b"\x00\x01" + len(records).to_bytes(2, "big") + b"\0\0\0\0"
                self.socket.sendto(query[:2] + flags + counts + question + b"".join(records), client)


class Setting:
    """The proxy, its name server, and replicas at addresses of this machine that share a port."""

    def __init__(self, proxy: Proxy, names: Names, port: int) -> None:
        self.proxy, self.names, self.port = proxy, names, port
        self.client = httpx.Client(base_url=proxy.url, verify=proxy.context, timeout=60, trust_env=False)
        self.replicas: list[Replica] = []

    def start(self, *addresses: str) -> list[Replica]:
        """Start replicas and let the name lead to all of them."""
        self.replicas += [Replica(address, self.port) for address in addresses]
        self.names.addresses += addresses
        assert eventually(lambda: self.client.get("/").status_code == 200, 10)
        for replica in self.replicas:
            replica.bodies.clear()
        return self.replicas

    def connection(self) -> socket.socket:
        """Return a connection to the proxy on which nothing was sent."""
        address = (HOME, httpx.URL(self.proxy.url).port or 0)
        return self.proxy.context.wrap_socket(
            socket.create_connection(address, timeout=10), server_hostname="localhost"
        )


@pytest.fixture
def setting(tmp_path: Path) -> Iterator[Setting]:
    names, port = Names(), free_port()
    text = NGINX.read_text(encoding="utf-8").replace("127.0.0.11 valid=2s", f"{HOME}:{names.port} valid=1s")
    text = text.replace("panoloc:8000", f"panoloc:{port}")
    # So that the tests need not wait as long, nor connect as often.
    for written, tried in (("_timeout 10s", "_timeout 1s"), ("body_timeout 30s", "body_timeout 1s"), (" 256;", " 3;")):
        assert written in text
        text = text.replace(written, tried)
    with proxy_of(text, tmp_path) as proxy:
        found = Setting(proxy, names, port)
        yield found
        found.client.close()
        for replica in found.replicas:
            replica.end()
        names.socket.close()


def test_the_proxy_starts_before_any_replica_and_follows_those_that_come_and_go(setting: Setting) -> None:
    assert setting.client.get("/maps").status_code == 502
    (first,) = setting.start("127.0.0.2")
    first.end()
    setting.replicas.clear()
    setting.names.addresses.clear()
    assert eventually(lambda: setting.client.get("/maps").status_code == 502, 10)
    (second,) = setting.start("127.0.0.3")
    assert setting.client.post("/maps", content=b"a scan").status_code == 200
    assert second.bodies == [b"a scan"]


def test_a_query_in_the_hands_of_a_replica_that_dies_is_answered_by_another(setting: Setting) -> None:
    replicas = setting.start("127.0.0.2", "127.0.0.3", "127.0.0.4")
    image = bytes(range(256)) * 20_000
    replicas[0].is_dying = replicas[1].is_dying = True
    for _ in range(12):
        assert setting.client.post("/localize", files={"image": image}).status_code == 200
    assert replicas[0].bodies or replicas[1].bodies, "nobody died"
    assert all(image in body for replica in replicas for body in replica.bodies)
    assert len(replicas[2].bodies) == 12


def test_an_upload_in_the_hands_of_a_replica_that_dies_is_not_repeated(setting: Setting) -> None:
    replicas = setting.start("127.0.0.2", "127.0.0.3")
    for replica in replicas:
        replica.is_dying = True
    assert setting.client.post("/maps", files={"file": b"a scan"}).status_code == 502
    assert sum(len(replica.bodies) for replica in replicas) == 1


def test_a_replica_that_is_gone_but_still_has_its_name_is_passed_over(setting: Setting) -> None:
    replicas = setting.start("127.0.0.2", "127.0.0.3", "127.0.0.4")
    setting.replicas = replicas[2:]
    for replica in replicas[:2]:
        replica.end()
    for _ in range(4):
        for path in ("/maps", "/localize", "/batches"):
            assert setting.client.post(path, files={"file": b"a scan"}).status_code == 200
    assert len(replicas[2].bodies) == 12


@pytest.mark.parametrize(
    "begun", [b"GET /maps HT", b"POST /localize HTTP/1.1\r\nHost: a\r\nContent-Length: 100\r\n\r\nabc"]
)
def test_who_sends_nothing_more_is_cut_off(setting: Setting, begun: bytes) -> None:
    setting.start("127.0.0.2")
    with setting.connection() as connection:
        connection.sendall(begun)
        assert b"200" not in connection.recv(1000)


def test_images_that_no_query_may_have_are_refused_before_they_come(setting: Setting) -> None:
    (replica,) = setting.start("127.0.0.2")
    with setting.connection() as connection:
        connection.sendall(b"POST /localize HTTP/1.1\r\nHost: a\r\nContent-Length: 300000000\r\n\r\n")
        assert connection.recv(1000).startswith(b"HTTP/1.1 413")
    assert replica.bodies == []


def test_one_address_gets_no_more_than_its_share_of_connections(setting: Setting) -> None:
    setting.start("127.0.0.2")
    held = [setting.connection() for _ in range(3)]
    for connection in held:
        # Requests whose bodies are under way.
        connection.sendall(b"POST /maps HTTP/1.1\r\nHost: a\r\nContent-Length: 100\r\n\r\n")
    assert eventually(lambda: setting.client.get("/maps").status_code == 429, 5)
    for connection in held:
        connection.close()
    assert eventually(lambda: setting.client.get("/maps").status_code == 200, 5)
