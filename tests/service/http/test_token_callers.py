"""Callers with tokens of an issuer, beside those with keys: what they see, what they are told, and what is written down."""

import json
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from panoloc.service.keys.key_file import KeyFile
from tests.service.http.running_service import RunningService, running_service
from tests.service.keys.issuer import AUDIENCE, ISSUER, Issuer

pytestmark = pytest.mark.anyio

ISSUED = Issuer()
EVERYTHING = "panoloc:read panoloc:localize panoloc:write"


@pytest.fixture
async def running(tmp_path: Path, redis_url: str, anyio_backend: str) -> AsyncIterator[RunningService]:
    keys = ISSUED.publish(tmp_path / "jwks.json", "rsa")
    settings = {"oidc_issuer": ISSUER, "oidc_audience": AUDIENCE, "oidc_keys": str(keys), "oidc_tenant_claim": "org"}
    async with running_service(tmp_path / "data", redis_url, **settings) as running:
        yield running


@pytest.mark.slow
async def test_those_of_one_tenant_share_its_maps_with_its_keys(running: RunningService) -> None:
    anna, bert = (ISSUED.token(sub=name, org="museum", scope=EVERYTHING) for name in ("anna", "bert"))
    map_id = await running.by(anna).ready_map()
    school = ISSUED.token(sub="cleo", org="school", scope=EVERYTHING)
    key = KeyFile(running.data_dir).make("tablet", ["read"], tenant="museum")[1]
    running.app.state.services.settings.keys._look_s = 0.0
    seen = [await running.by(who).status("GET", f"/maps/{map_id}") for who in (anna, bert, school, key)]
    assert seen == [200, 200, 404, 200]
    (line,) = map(json.loads, (running.data_dir / "audit.jsonl").read_text().splitlines())
    assert (line["who"], line["change"], line["what"]) == ("token anna", "map registered", map_id)


async def test_a_token_may_do_what_its_scopes_say(running: RunningService) -> None:
    map_id = await running.by(ISSUED.token(org="museum", scope=EVERYTHING)).ready_map()
    visitor = ISSUED.token(sub="visitor", org="museum", scope="panoloc:localize")
    assert (await running.by(visitor).localize(map_id)).status_code == 200
    refused = await running.by(visitor).client.delete(f"/maps/{map_id}")
    assert (refused.status_code, refused.json()["type"]) == (403, "/problems/scope-missing")
    assert "'panoloc:write' in its claim 'scope'" in refused.json()["detail"]


@pytest.mark.parametrize(
    ("claims", "said"),
    [
        ({"exp": int(time.time()) - 3600}, "has expired"),
        ({"aud": "mail"}, "for the audience 'panoloc'"),
        ({"org": None}, "whose claim 'org' is a name"),
    ],
)
async def test_whose_token_opens_nothing_is_told_why_without_a_pause(
    running: RunningService, claims: dict[str, Any], said: str
) -> None:
    began = time.monotonic()
    # More than may wait for the pauses of wrong keys, which would take a second each.
    for _ in range(10):
        refused = await running.by(ISSUED.token(**{"org": "museum"} | claims)).client.get("/maps")
        assert (refused.status_code, refused.json()["type"]) == (401, "/problems/key-missing")
        assert said in refused.json()["detail"]
    assert time.monotonic() - began < 5


async def test_a_token_that_was_made_up_waits_like_a_wrong_key(
    running: RunningService, monkeypatch: pytest.MonkeyPatch
) -> None:
    waited = []

    async def wait(address: str) -> None:
        waited.append(address)

    monkeypatch.setattr(running.app.state.services.wrong_keys, "wait", wait)
    head, payload, _ = ISSUED.token(org="museum").split(".")
    refused = await running.by(f"{head}.{payload}.c2lnbmVk").client.get("/maps")
    assert refused.status_code == 401
    assert "signature" in refused.json()["detail"]
    assert len(waited) == 1
    assert await running.status("GET", "/maps") == 401


async def test_a_key_that_the_issuer_has_just_published_opens_at_the_first_request(
    running: RunningService, tmp_path: Path
) -> None:
    ISSUED.publish(tmp_path / "jwks.json", "rsa", "ec")
    assert await running.by(ISSUED.token("ec", org="museum")).status("GET", "/maps") == 200
