"""Tokens of an issuer: what opens the service, what does not, and what a caller is told."""

import asyncio
import base64
import json
import time
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from threading import Thread
from typing import Any

import jwt
import pytest
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from service.keys.caller import ALL_SCOPES, Caller
from service.keys.key_ring import KeyRing
from service.keys.signing_keys import SigningKeys, keys_of
from service.keys.tokens import TokenRefusedError, TokenRules, Tokens
from tests.service.keys.issuer import AUDIENCE, ISSUER, Issuer

ISSUED = Issuer()
RULES = TokenRules(ISSUER, AUDIENCE, "scope", "sub")


@pytest.fixture
def keys(tmp_path: Path) -> SigningKeys:
    return SigningKeys(str(ISSUED.publish(tmp_path / "jwks.json")), look_s=0.0)


def caller(keys: SigningKeys, token: str, rules: TokenRules = RULES) -> Caller:
    return Tokens(rules, keys).caller_of(token)


@pytest.mark.parametrize("key_id", ["rsa", "ec", "ed"])
def test_a_token_opens_what_its_scopes_say_for_its_tenant(keys: SigningKeys, key_id: str) -> None:
    token = ISSUED.token(key_id, scope="openid panoloc:read panoloc.localize panoloc:fly read")
    assert caller(keys, token) == Caller("token anna", frozenset({"read", "localize"}), "anna")


def test_scopes_and_tenants_are_read_where_the_issuer_puts_them(keys: SigningKeys) -> None:
    roles: dict[str, Any] = {
        "resource_access": {"panoloc": {"roles": ["panoloc:write", 7, "offline"]}},
        "org": {"id": "museum"},
    }
    rules = TokenRules(ISSUER, AUDIENCE, "resource_access.panoloc.roles", "org.id")
    assert caller(keys, ISSUED.token(**roles), rules) == Caller("token anna", frozenset({"write"}), "museum")
    url = "https://example.org/roles"
    rules = TokenRules(ISSUER, AUDIENCE, url, "sub")
    roles = {url: ["panoloc:read"]}
    assert caller(keys, ISSUED.token(**roles), rules).scopes == {"read"}
    assert caller(keys, ISSUED.token(), rules).scopes == frozenset()
    assert caller(keys, ISSUED.token(scope="panoloc:admin")) == Caller("token anna", ALL_SCOPES, None)


def test_a_token_may_be_for_several_audiences_and_name_no_key(keys: SigningKeys) -> None:
    algorithm, key = ISSUED.keys["ec"]
    claims = {"iss": ISSUER, "aud": ["other", AUDIENCE], "sub": "anna", "exp": time.time() + 9}
    assert caller(keys, jwt.encode(claims, key, algorithm)).id == "token anna"


def with_claims(token: str, **claims: Any) -> str:
    head, payload, signature = token.split(".")
    said = json.loads(base64.urlsafe_b64decode(payload + "=="))
    forged = base64.urlsafe_b64encode(json.dumps(said | claims).encode()).rstrip(b"=").decode()
    return f"{head}.{forged}.{signature}"


def of_a_stranger() -> str:
    stranger = rsa.generate_private_key(public_exponent=65537, key_size=2048)
    claims = {"iss": ISSUER, "aud": AUDIENCE, "sub": "anna", "exp": time.time() + 9}
    return jwt.encode(claims, stranger, "RS256", headers={"kid": "rsa"})


def signed_with_what_is_public() -> str:
    """The classic confusion: the public key, which anybody has, as if it were a shared secret."""
    public = ISSUED.keys["rsa"][1].public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)
    head, payload = (
        base64.urlsafe_b64encode(json.dumps(part).encode()).rstrip(b"=").decode()
        for part in (
            {"alg": "HS256", "kid": "rsa"},
            {"iss": ISSUER, "aud": AUDIENCE, "sub": "a", "exp": time.time() + 9},
        )
    )
    signature = jwt.algorithms.HMACAlgorithm(jwt.algorithms.HMACAlgorithm.SHA256).sign(
        f"{head}.{payload}".encode(), public
    )
    return f"{head}.{payload}.{base64.urlsafe_b64encode(signature).rstrip(b'=').decode()}"


BAD: dict[str, tuple[Callable[[], str], str, bool]] = {
    "expired": (lambda: ISSUED.token(exp=int(time.time()) - 60), "has expired", True),
    "not valid yet": (lambda: ISSUED.token(nbf=int(time.time()) + 600), "not yet valid", True),
    "without an end": (lambda: ISSUED.token(exp=None), '"exp"', True),
    "for others": (lambda: ISSUED.token(aud="mail"), "audience", True),
    "for nobody": (lambda: ISSUED.token(aud=None), '"aud"', True),
    "of another issuer": (lambda: ISSUED.token(iss="https://evil.example.org"), "issuer", True),
    "of nobody": (lambda: ISSUED.token(sub=None), "sub", True),
    "for all tenants": (lambda: ISSUED.token(sub="*"), "'sub'", True),
    "with a line break": (lambda: ISSUED.token(sub="anna\nadmin"), "'sub'", True),
    "changed": (lambda: with_claims(ISSUED.token(), scope="panoloc:admin"), "signature", False),
    "of a stranger": (of_a_stranger, "signature", False),
    "of an unknown key": (lambda: ISSUED.token(headers={"kid": "next"}), "unknown key", False),
    "of another algorithm than its key": (lambda: ISSUED.token("ec", headers={"kid": "rsa"}), "unknown key", False),
    "unsigned": (lambda: jwt.encode({"sub": "a"}, "", "none", headers={"kid": "rsa"}), "algorithm 'none'", False),
    "signed with what is public": (signed_with_what_is_public, "algorithm 'HS256'", False),
    "no token": (lambda: "a.b.c", "neither", False),
}


@pytest.mark.parametrize("name", BAD)
def test_a_token_opens_nothing_that_is(name: str, keys: SigningKeys) -> None:
    make, said, is_genuine = BAD[name]
    with pytest.raises(TokenRefusedError, match=said) as refused:
        caller(keys, make())
    assert refused.value.is_genuine == is_genuine


def test_keys_of_a_file_are_those_that_are_in_it_now(keys: SigningKeys, caplog: pytest.LogCaptureFixture) -> None:
    path = Path(keys.place)
    ISSUED.publish(path, "ec")
    assert caller(keys, ISSUED.token("ec")).id == "token anna"
    with pytest.raises(TokenRefusedError, match="unknown key"):
        caller(keys, ISSUED.token("rsa"))
    path.write_text("{}")
    assert caller(keys, ISSUED.token("ec")).id == "token anna"
    assert "cannot be read" in caplog.text
    ISSUED.publish(path, "rsa")
    assert caller(keys, ISSUED.token("rsa")).id == "token anna"


def test_of_a_set_only_public_keys_that_sign_are_used() -> None:
    def usable(*listed: Any) -> list[str | None]:
        return [key.id for key in keys_of(json.dumps({"keys": listed}).encode())]

    secret = {"kty": "oct", "k": "c2VjcmV0", "kid": "secret", "alg": "HS256"}
    assert usable(secret, ISSUED.jwk("rsa"), ISSUED.jwk("ec") | {"use": "enc"}, {"kty": "new"}) == ["rsa"]
    (private,) = keys_of(json.dumps({"keys": [ISSUED.jwk("rsa", private=True)]}).encode())
    assert isinstance(private.key.key, rsa.RSAPublicKey)
    for listed in ([], [secret], [{"kty": "RSA"}], [7]):
        with pytest.raises(ValueError, match="JWK set"):
            usable(*listed)


class _Published(BaseHTTPRequestHandler):
    document = b""

    def do_GET(self) -> None:
        self.send_response(200 if self.document else 503)
        self.end_headers()
        self.wfile.write(self.document)

    def log_message(self, *_: object) -> None:
        pass


@pytest.mark.slow
@pytest.mark.anyio
async def test_keys_of_a_url_are_fetched_again_for_a_token_that_names_a_new_one() -> None:
    with HTTPServer(("127.0.0.1", 0), _Published) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        try:
            keys = SigningKeys(f"http://127.0.0.1:{server.server_port}/jwks", shortest_pause_s=0.0)
            assert not await keys.fetch()
            with pytest.raises(TokenRefusedError) as refused:
                caller(keys, ISSUED.token("ec"))
            assert refused.value.may_be_new
            _Published.document = json.dumps(ISSUED.jwks("ec")).encode()
            assert await keys.fetch()
            assert caller(keys, ISSUED.token("ec")).id == "token anna"
            _Published.document = b"[" * 2**21
            assert not await keys.fetch()
            assert caller(keys, ISSUED.token("ec")).id == "token anna"
            _Published.document = json.dumps(ISSUED.jwks("rsa")).encode()
            keys._shortest_pause_s = 60.0
            assert not await keys.fetch(), "asked again at once"
            following = SigningKeys(keys.place)
            task = asyncio.create_task(following.follow())
            for _ in range(500):
                if following.that_may_have_signed("rsa", "RS256"):
                    break
                await asyncio.sleep(0.01)
            task.cancel()
            assert caller(following, ISSUED.token("rsa")).id == "token anna"
        finally:
            server.shutdown()


def test_keys_and_tokens_open_the_same_service(tmp_path: Path, keys: SigningKeys) -> None:
    ring = KeyRing("written-down.with.dots", tmp_path, Tokens(RULES, keys))
    assert ring.required
    assert ring.find("written-down.with.dots") is not None
    found = ring.find(ISSUED.token())
    assert found is not None
    assert found.id == "token anna"
    with pytest.raises(TokenRefusedError, match="unknown one"):
        ring.caller_of("guessed")
    assert KeyRing("", tmp_path).find(ISSUED.token()) is None
    assert not KeyRing("", tmp_path).required
