"""An issuer of OpenID Connect tokens, with keys of its own."""

import json
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jwt
from cryptography.hazmat.primitives.asymmetric import ec, ed25519, rsa
from jwt.algorithms import ECAlgorithm, OKPAlgorithm, RSAAlgorithm

ISSUER, AUDIENCE = "https://login.example.org/realms/museum", "panoloc"


class Issuer:
    """Signs tokens with keys by their ids, and publishes what verifies them."""

    def __init__(self) -> None:
        self.keys: dict[str, tuple[str, Any]] = {
            "rsa": ("RS256", rsa.generate_private_key(public_exponent=65537, key_size=2048)),
            "ec": ("ES256", ec.generate_private_key(ec.SECP256R1())),
            "ed": ("EdDSA", ed25519.Ed25519PrivateKey.generate()),
        }

    def token(self, key_id: str = "rsa", headers: Mapping[str, Any] | None = None, **claims: Any) -> str:
        """Return a token that is right but for what `claims` say; None leaves a claim out."""
        algorithm, key = self.keys[key_id]
        now = int(time.time())
        said = {
            "iss": ISSUER,
            "aud": AUDIENCE,
            "sub": "anna",
            "exp": now + 300,
            "scope": "openid panoloc:read",
        } | claims
        payload = {name: value for name, value in said.items() if value is not None}
        return jwt.encode(payload, key, algorithm, headers={"kid": key_id} | dict(headers or {}))

    def jwks(self, *key_ids: str, **more: Any) -> dict[str, Any]:
        """Return the set of public keys of these ids, all where none is named; more: fields of each."""
        return {"keys": [{**self.jwk(each), **more} for each in key_ids or self.keys]}

    def jwk(self, key_id: str, private: bool = False) -> dict[str, Any]:
        """Return one key."""
        algorithm, key = self.keys[key_id]
        kind: Any = {"RS256": RSAAlgorithm, "ES256": ECAlgorithm, "EdDSA": OKPAlgorithm}[algorithm]
        return {**json.loads(kind.to_jwk(key if private else key.public_key())), "kid": key_id}

    def publish(self, path: Path, *key_ids: str) -> Path:
        """Write the set into a file."""
        path.write_text(json.dumps(self.jwks(*key_ids)))
        return path
