"""What an operator says of tokens, and what he is told where it cannot be right."""

import asyncio
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from panoloc.service.settings import Settings
from tests.service.keys.issuer import AUDIENCE, ISSUER, Issuer

ISSUED = Issuer()


def given(tmp_path: Path, **settings: Any) -> Settings:
    jwks = ISSUED.publish(tmp_path / "jwks.json")
    right: dict[str, Any] = {"oidc_issuer": ISSUER, "oidc_audience": AUDIENCE, "oidc_keys": str(jwks)}
    return Settings(data_dir=tmp_path, **(right | settings))


def test_tokens_close_a_service_and_open_it(tmp_path: Path) -> None:
    keys = given(tmp_path).keys
    assert keys.required
    assert keys.tokens is not None
    asyncio.run(keys.tokens.keys.refresh())
    assert keys.find(ISSUED.token()) is not None
    assert not Settings(data_dir=tmp_path).keys.required


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"oidc_audience": None}, "expected PANOLOC_OIDC_AUDIENCE as well"),
        ({"oidc_issuer": None, "oidc_keys": None}, "expected PANOLOC_OIDC_ISSUER and PANOLOC_OIDC_KEYS as well"),
        ({"oidc_keys": "nowhere/jwks.json"}, "No such file"),
        ({"oidc_keys": __file__}, "expected a JWK set"),
        ({"oidc_keys": "http://login.example.org/jwks"}, "expected an https:// URL or a file"),
        ({"oidc_tenant_claim": ""}, "at least 1 character"),
    ],
)
def test_what_cannot_be_right_is_said_before_the_start(tmp_path: Path, settings: dict[str, Any], said: str) -> None:
    with pytest.raises(ValidationError, match=said):
        given(tmp_path, **settings)
