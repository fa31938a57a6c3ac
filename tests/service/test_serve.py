"""What `panoloc serve` does before it serves: it hides its secrets from its children and warns of what is open."""

import pytest

from service.serve import take_secrets_out, why_exposed
from service.settings import Settings


def test_children_inherit_no_keys() -> None:
    environment = {
        "PANOLOC_API_KEYS": "a-secret",
        "PANOLOC_REDIS_URL": "redis://:secret@cache",
        "PANOLOC_PORT": "8000",
        "PATH": "/bin",
    }
    take_secrets_out(environment)
    assert environment == {"PANOLOC_PORT": "8000", "PATH": "/bin"}
    take_secrets_out(environment)


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "", "192.168.1.5", "panoloc.example"])
def test_a_service_that_others_reach_without_a_key_warns_as_the_container_does(host: str) -> None:
    warning = why_exposed(Settings(host=host, port=8000))
    assert warning is not None
    assert "PANOLOC_API_KEYS" in warning
    assert why_exposed(Settings(host=host, api_keys="a-long-key")) is None


@pytest.mark.parametrize("host", ["127.0.0.1", "::1", "localhost", "127.0.0.2"])
def test_a_service_for_this_machine_alone_does_not_warn(host: str) -> None:
    assert why_exposed(Settings(host=host)) is None
