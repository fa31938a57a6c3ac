"""A service that speaks HTTPS with a certificate of `panoloc certificate`, and a command that speaks with it."""

import os
import ssl
import subprocess
import sys
from pathlib import Path

import httpx
import pytest

from panoloc.service.host.certificates import make_certificate
from panoloc.service.settings import Settings
from tests.integration.running_service import ROOT, RunningService, eventually

pytestmark = pytest.mark.integration


def test_programs_that_trust_the_authority_speak_with_the_service_and_others_do_not(tmp_path: Path) -> None:
    make_certificate(tmp_path, ["scanner.local"])
    files = {"tls_cert": str(tmp_path / "server.crt"), "tls_key": str(tmp_path / "server.key")}
    service = RunningService(tmp_path / "data", **files)
    url, authority = f"https://127.0.0.1:{service.port}", str(tmp_path / "ca.crt")
    try:
        with httpx.Client(base_url=url, verify=ssl.create_default_context(cafile=authority)) as client:
            assert eventually(lambda: "Uvicorn running" in service.log, 60), service.log
            assert client.get("/maps").json()["items"] == []
            by_name = client.get("/maps", headers={"Host": f"scanner.local:{service.port}"})
            other = client.get("/maps", headers={"Host": "other.local"})
            assert (by_name.status_code, other.status_code) == (200, 403)
        with pytest.raises(httpx.ConnectError, match="CERTIFICATE_VERIFY_FAILED"):
            httpx.get(f"{url}/maps")
        variables = os.environ | {"SSL_CERT_FILE": authority, "PANOLOC_URL": url}
        command = [sys.executable, "-m", "panoloc.service.cli", "maps", "--json"]
        done = subprocess.run(command, cwd=ROOT, env=variables, capture_output=True, text=True, timeout=60)
        assert done.returncode == 0, done.stderr
        del variables["SSL_CERT_FILE"]
        done = subprocess.run(command, cwd=ROOT, env=variables, capture_output=True, text=True, timeout=60)
        assert (done.returncode, "SSL_CERT_FILE to its ca.crt" in done.stdout + done.stderr) == (1, True)
    finally:
        service.stop()


def test_the_authority_stays_and_what_it_signed_before_is_trusted_still(tmp_path: Path) -> None:
    assert make_certificate(tmp_path, ["a.local", "10.0.0.3"]) == ["localhost", "127.0.0.1", "a.local", "10.0.0.3"]
    files = [tmp_path / name for name in ("ca.crt", "ca.key", "server.crt", "server.key")]
    before = [path.read_bytes() for path in files]
    assert [path.stat().st_mode & 0o777 for path in files if path.suffix == ".key"] == [0o600] * 2
    # Without names those of before.
    assert make_certificate(tmp_path, ()) == ["localhost", "127.0.0.1", "a.local", "10.0.0.3"]
    assert [old == path.read_bytes() for old, path in zip(before, files, strict=True)] == [True, True, False, False]
    context = ssl.create_default_context(cafile=str(files[0]))
    assert context.cert_store_stats()["x509_ca"] == 1
    make_certificate(tmp_path / "other", ())
    for key in (b"no key", (tmp_path / "other" / "ca.key").read_bytes(), None):
        files[1].unlink()
        if key is not None:
            files[1].write_bytes(key)
        with pytest.raises(OSError, match="remove both to make a new one"):
            make_certificate(tmp_path, ())
        files[1].touch()


@pytest.mark.parametrize("name", ["https://a.local", "a.local:8443", "a b", "[::1]", "", "*", "a" * 300])
def test_what_is_no_name_gets_no_certificate(tmp_path: Path, name: str) -> None:
    with pytest.raises(ValueError, match="expected a name such as scanner"):
        make_certificate(tmp_path, [name])


def test_names_of_other_scripts_are_certified_as_browsers_send_them(tmp_path: Path) -> None:
    assert make_certificate(tmp_path, ["müller.local", "::1"])[2:] == ["xn--mller-kva.local", "::1"]


def test_a_certificate_without_its_key_is_refused_at_the_start(tmp_path: Path) -> None:
    make_certificate(tmp_path / "one", ())
    make_certificate(tmp_path / "two", ())
    certificate = tmp_path / "one" / "server.crt"
    with pytest.raises(ValueError, match="both PANOLOC_TLS_CERT and PANOLOC_TLS_KEY"):
        Settings(tls_cert=certificate)
    for key in (tmp_path / "two" / "server.key", tmp_path / "none.key"):
        with pytest.raises(ValueError, match="expected a certificate and its key"):
            Settings(tls_cert=certificate, tls_key=key)
