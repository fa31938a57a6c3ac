"""The proxy before several API replicas, configured as docker/ has it."""

import os
import shutil
import ssl
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import httpx

from tests.integration.running_service import ROOT, eventually, free_port

NGINX = ROOT / "docker" / "nginx" / "nginx.conf"
_TOOLS = {"nginx": "/usr/sbin/nginx", "openssl": "/usr/bin/openssl"}  # who is not root does not look in sbin


@dataclass(frozen=True)
class Proxy:
    """url: where it listens. context: trusts its certificate."""

    url: str
    context: ssl.SSLContext


def missing_tool() -> str | None:
    """Return what has to be installed before there can be a proxy."""
    return next((name for name, usual in _TOOLS.items() if _path_of(name, usual) is None), None)


@contextmanager
def proxy_before(addresses: Sequence[str], folder: Path) -> Iterator[Proxy]:
    """Run it before replicas, `host:port` each, on ports of their own; its files go into `folder`."""
    servers = "".join(f"server {address} max_fails=0; " for address in addresses)
    text = NGINX.read_text(encoding="utf-8").replace("http://panoloc:8000", "http://replicas")
    with proxy_of(
        text.replace("    server {\n", f"    upstream replicas {{ {servers}}}\n    server {{\n", 1), folder
    ) as proxy:
        yield proxy


@contextmanager
def proxy_of(configuration: str, folder: Path) -> Iterator[Proxy]:
    """Run nginx with this configuration, on a free port, with a certificate of its own."""
    key, certificate, port = folder / "tls.key", folder / "tls.crt", free_port()
    subprocess.run(
        [str(_path_of("openssl", _TOOLS["openssl"])), "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-keyout", key,
         "-out", certificate, "-days", "2", "-subj", "/CN=localhost", "-addext", "subjectAltName=DNS:localhost"],
        check=True, capture_output=True,
    )  # fmt: skip
    configuration = configuration.replace("/tmp/", f"{folder}/")
    configuration = configuration.replace("8443", f"127.0.0.1:{port}").replace("/etc/nginx/tls", str(folder))
    # Not as many as there are processors: this machine has other things to do.
    configuration = configuration.replace("worker_processes auto", "worker_processes 1")
    (folder / "nginx.conf").write_text(configuration)
    # Its workers would be of a user who may not enter the folders of tests.
    user = "user root;" if os.getuid() == 0 else ""
    command = [str(_path_of("nginx", _TOOLS["nginx"])), "-c", str(folder / "nginx.conf"), "-g", f"daemon off; {user}"]
    # A pipe that nobody reads fills up with messages of replicas that are gone, and then nginx waits for ever.
    with (folder / "nginx.log").open("wb") as log:
        process = subprocess.Popen(command, stderr=log)
    proxy = Proxy(f"https://localhost:{port}", ssl.create_default_context(cafile=certificate))
    try:
        assert eventually(lambda: process.poll() is not None or _listens(proxy), 90)
        assert process.poll() is None
        yield proxy
    finally:
        process.terminate()
        process.wait()


def _listens(proxy: Proxy) -> bool:
    """Tell whether anything is answered, be it that no replica is there."""
    try:
        httpx.get(proxy.url, verify=proxy.context, trust_env=False)
    except httpx.TransportError:
        return False
    return True


def _path_of(tool: str, usual: str) -> str | None:
    return shutil.which(tool) or shutil.which(usual)
