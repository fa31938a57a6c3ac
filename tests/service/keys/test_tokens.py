"""Tokens of an issuer: what opens the service, what does not, and what a caller is told."""

import asyncio
import base64
import json
import time
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from threading import Thread
from typing import Any

import jwt
import pytest
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from panoloc.service.keys.caller import ALL_SCOPES, Caller
from panoloc.service.keys.key_ring import KeyRing
from panoloc.service.keys.tokens import IssuerKeys, TokenRefusedError, Tokens, read_keys
from tests.service.keys.issuer import AUDIENCE, ISSUER, Issuer

ISSUED = Issuer()


@pytest.fixture
def keys(tmp_path: Path) -> IssuerKeys:
    found = IssuerKeys(str(ISSUED.publish(tmp_path / "jwks.json")))
    asyncio.run(found.refresh())
    return found


def caller(keys: IssuerKeys, token: str, scopes_claim: str = "scope", tenant_claim: str = "sub") -> Caller:
    return Tokens(ISSUER, AUDIENCE, scopes_claim, tenant_claim, keys).caller_of(token)


@pytest.mark.parametrize("key_id", ["rsa", "ec", "ed"])
def test_a_token_opens_what_its_scopes_say_for_its_tenant(keys: IssuerKeys, key_id: str) -> None:
    token = ISSUED.token(key_id, scope="openid panoloc:read panoloc.localize panoloc:fly read")
    assert caller(keys, token) == Caller("token anna", frozenset({"read", "localize"}), "anna")


def test_scopes_and_tenants_are_read_where_the_issuer_puts_them(keys: IssuerKeys) -> None:
    roles: dict[str, Any] = {
        "resource_access": {"panoloc": {"roles": ["panoloc:write", 7, "offline"]}},
        "org": {"id": "museum"},
    }
    claims = "resource_access.panoloc.roles", "org.id"
    assert caller(keys, ISSUED.token(**roles), *claims) == Caller("token anna", frozenset({"write"}), "museum")
    url = "https://example.org/roles"
    roles = {url: ["panoloc:read"]}
    assert caller(keys, ISSUED.token(**roles), url).scopes == {"read"}
    assert caller(keys, ISSUED.token(), url).scopes == frozenset()
    assert caller(keys, ISSUED.token(scope="panoloc:admin")) == Caller("token anna", ALL_SCOPES, None)


def test_a_token_may_be_for_several_audiences_and_name_no_key(keys: IssuerKeys) -> None:
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
def test_a_token_opens_nothing_that_is(name: str, keys: IssuerKeys) -> None:
    make, said, is_genuine = BAD[name]
    with pytest.raises(TokenRefusedError, match=said) as refused:
        caller(keys, make())
    assert refused.value.is_genuine == is_genuine


def test_keys_of_a_file_are_those_that_are_in_it_now(keys: IssuerKeys, caplog: pytest.LogCaptureFixture) -> None:
    path = Path(keys.place)
    ISSUED.publish(path, "ec")
    asyncio.run(keys.refresh())
    assert caller(keys, ISSUED.token("ec")).id == "token anna"
    with pytest.raises(TokenRefusedError, match="unknown key"):
        caller(keys, ISSUED.token("rsa"))
    path.write_text("{}")
    asyncio.run(keys.refresh())
    assert caller(keys, ISSUED.token("ec")).id == "token anna"
    assert "cannot be read" in caplog.text


def test_of_a_set_only_public_keys_that_sign_are_used(tmp_path: Path) -> None:
    def usable(*listed: Any) -> list[str | None]:
        path = tmp_path / "jwks.json"
        path.write_text(json.dumps({"keys": listed}))
        return [key.key_id for key in read_keys(str(path))]

    secret = {"kty": "oct", "k": "c2VjcmV0", "kid": "secret", "alg": "HS256"}
    private = ISSUED.jwk("ed", private=True)
    assert usable(secret, private, ISSUED.jwk("rsa"), ISSUED.jwk("ec") | {"use": "enc"}, {"kty": "new"}) == ["rsa"]
    for listed in ([], [secret], [private], [{"kty": "RSA"}], [7]):
        with pytest.raises(ValueError, match="JWK set"):
            usable(*listed)


@pytest.mark.parametrize("document", [b"", b"{", b"[]", b"7", b"[" * 100_000, b"\xff", b'{"keys": 7}'])
def test_a_damaged_set_is_refused(tmp_path: Path, document: bytes) -> None:
    (tmp_path / "jwks.json").write_bytes(document)
    with pytest.raises(ValueError, match="expected a JWK set"):
        read_keys(str(tmp_path / "jwks.json"))


class _Published(BaseHTTPRequestHandler):
    document = b""
    num_asked = 0

    def do_GET(self) -> None:
        _Published.num_asked += 1
        self.send_response(200 if self.document else 503)
        self.end_headers()
        self.wfile.write(self.document)

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def url() -> Iterator[str]:
    _Published.document, _Published.num_asked = b"", 0
    with HTTPServer(("127.0.0.1", 0), _Published) as server:
        Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}/jwks"
        server.shutdown()


@pytest.mark.anyio
async def test_keys_of_a_url_are_fetched_again_and_those_that_are_known_stay(url: str) -> None:
    keys = IssuerKeys(url, pause_s=0.0)
    await keys.refresh()
    with pytest.raises(TokenRefusedError) as refused:
        caller(keys, ISSUED.token("ec"))
    assert refused.value.may_be_new
    _Published.document = json.dumps(ISSUED.jwks("ec")).encode()
    await keys.refresh()
    for document in (b"[" * 10_000, b""):
        _Published.document = document
        await keys.refresh()
        assert caller(keys, ISSUED.token("ec")).id == "token anna"


@pytest.mark.anyio
async def test_tokens_of_unknown_keys_make_no_flood_of_requests_to_the_issuer(url: str) -> None:
    keys = IssuerKeys(url)
    await asyncio.gather(*(keys.refresh() for _ in range(10)))
    assert _Published.num_asked == 1


@pytest.mark.anyio
async def test_keys_are_there_as_soon_as_they_are_followed(url: str) -> None:
    _Published.document = json.dumps(ISSUED.jwks("rsa")).encode()
    keys = IssuerKeys(url)
    following = asyncio.create_task(keys.follow())
    async with asyncio.timeout(10):
        while not keys.of("rsa"):
            await asyncio.sleep(0.01)
    following.cancel()


def test_keys_and_tokens_open_the_same_service(tmp_path: Path, keys: IssuerKeys) -> None:
    ring = KeyRing("written-down.with.dots", tmp_path, Tokens(ISSUER, AUDIENCE, "scope", "sub", keys))
    assert ring.required
    assert ring.find("written-down.with.dots") is not None
    found = ring.find(ISSUED.token())
    assert found is not None
    assert found.id == "token anna"
    with pytest.raises(TokenRefusedError, match="unknown one"):
        ring.caller_of("guessed")
    assert KeyRing("", tmp_path).find(ISSUED.token()) is None
    assert not KeyRing("", tmp_path).required
