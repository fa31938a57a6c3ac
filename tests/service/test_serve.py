"""What `panoloc serve` does before it serves: it hides its secrets from its children and warns of what is open."""

import logging
import os
import pickle
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from panoloc.service.host.run_folder import lock_folder
from panoloc.service.serve import run_service, take_secrets_out, why_exposed
from panoloc.service.settings import Settings
from panoloc.service.storage.claim import BucketClaim
from panoloc.service.worker.plan import WorkerPlan
from tests.service.storage.bucket_server import BUCKET, BucketServer


@pytest.fixture(autouse=True)
def logging_as_before() -> Iterator[None]:
    """A service that starts takes over the logging of its process."""
    root = logging.getLogger()
    handlers, level = list(root.handlers), root.level
    yield
    root.handlers, root.level = handlers, level


def test_children_inherit_no_keys() -> None:
    environment = {
        "PANOLOC_API_KEYS": "a-secret",
        "PANOLOC_REDIS_URL": "redis://:secret@cache",
        "AWS_SECRET_ACCESS_KEY": "a-secret",
        "GOOGLE_SERVICE_ACCOUNT_KEY": "{}",
        "AZURE_STORAGE_ACCOUNT_KEY": "a-secret",
        "PANOLOC_PORT": "8000",
        "PATH": "/bin",
    }
    take_secrets_out(environment)
    assert environment == {"PANOLOC_PORT": "8000", "PATH": "/bin"}
    take_secrets_out(environment)


_SHOWS_ITSELF = """
import os, sys
from panoloc.service.serve import take_secrets_out
take_secrets_out(os.environ)
sys.stdout.buffer.write(open("/proc/self/environ", "rb").read())
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="other systems show nobody the environment of a process")
def test_no_process_of_the_same_user_finds_keys_in_what_the_system_shows() -> None:
    secrets = {"AWS_SECRET_ACCESS_KEY": "a-secret", "PANOLOC_API_KEYS": "a-secret-too", "PANOLOC_PORT": "8123"}
    shown = subprocess.run(
        [sys.executable, "-c", _SHOWS_ITSELF], env={**os.environ, **secrets}, stdout=subprocess.PIPE, check=True
    ).stdout
    assert b"secret" not in shown
    assert b"PANOLOC_PORT=8123" in shown


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "", "192.168.1.5", "panoloc.example"])
def test_a_service_that_others_reach_without_a_key_warns_as_the_container_does(host: str) -> None:
    warning = why_exposed(Settings(host=host, port=8000))
    assert warning is not None
    assert "PANOLOC_API_KEYS" in warning
    assert why_exposed(Settings(host=host, api_keys="a-long-key")) is None


@pytest.mark.parametrize("host", ["127.0.0.1", "::1", "localhost", "127.0.0.2"])
def test_a_service_for_this_machine_alone_does_not_warn(host: str) -> None:
    assert why_exposed(Settings(host=host)) is None


def test_workers_get_the_key_of_the_bucket_with_their_plan(
    bucket_server: BucketServer, prefix: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        for name, value in bucket_server.variables.items():
            patch.setenv(name, value)
        settings = Settings(data_dir=tmp_path, storage=f"s3://{BUCKET}/{prefix}")
        # In this order, and on the way to the pool the settings are copied.
        assert settings.bucket_access is not None
        take_secrets_out(os.environ)
        plan = WorkerPlan.of(settings.model_copy(update={"redis_url": "redis://x"}), "redis://x")
        travelled: WorkerPlan = pickle.loads(pickle.dumps(plan))
        travelled.open_storage().put("key", b"by a worker")
    assert bucket_server.storage(tmp_path, prefix).read("key") == b"by a worker"
    assert "a-secret" not in repr(plan) + repr(settings)


@pytest.mark.parametrize(
    ("url", "is_refused", "said"),
    [
        ("s3://no-such-bucket/x", False, "NoSuchBucket"),
        (f"s3://{BUCKET}/x", True, "the key and its rights"),
        ("az://container", False, "expected variables for the access to az://container"),
    ],
)
def test_a_bucket_that_cannot_be_used_ends_the_start_with_one_line(
    url: str,
    is_refused: bool,
    said: str,
    bucket_server: BucketServer,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    with bucket_server.refusing(is_refused), monkeypatch.context() as patch:
        for name, value in bucket_server.variables.items():
            patch.setenv(name, value)
        assert run_service(Settings(data_dir=tmp_path, storage=url, log_format="json")) == 1
    lines = [line for line in capfd.readouterr().err.splitlines() if "cannot start" in line]
    assert len(lines) == 1
    assert said in lines[0]
    assert "a-secret" not in lines[0]


def test_a_folder_of_files_elsewhere_has_one_service_at_a_time_too(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    other = lock_folder(tmp_path / "scans", is_shared=False)
    assert run_service(Settings(data_dir=tmp_path / "data", storage=f"file://{tmp_path}/scans")) == 1
    other.close()
    assert f"{tmp_path}/scans: expected an unused data folder" in capfd.readouterr().err


@pytest.mark.slow
def test_a_bucket_has_one_service_at_a_time(
    bucket_server: BucketServer,
    prefix: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr("panoloc.service.storage.claim._RENEW_S", 0.1)
    other = BucketClaim(bucket_server.storage(tmp_path, prefix), tmp_path, is_shared=True)
    other.take()
    for name, value in bucket_server.variables.items():
        monkeypatch.setenv(name, value)
    assert run_service(Settings(data_dir=tmp_path / "data", storage=f"s3://{BUCKET}/{prefix}")) == 1
    other.release()
    assert "expected an unused bucket prefix, but the service with process id" in capfd.readouterr().err
