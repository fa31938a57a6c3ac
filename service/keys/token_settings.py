"""The settings of tokens: which issuer is trusted, and what its tokens are read for."""

from pathlib import Path
from typing import Self

from pydantic import Field, field_validator, model_validator
from pydantic_settings import BaseSettings

from service.keys.signing_keys import SigningKeys, is_url, keys_of
from service.keys.tokens import TokenRules, Tokens


class TokenSettings(BaseSettings):
    """Part of `service.settings.Settings`."""

    oidc_issuer: str | None = Field(
        None,
        description="Issuer (`iss`) of OpenID Connect tokens that open the service as keys do, verified without asking it; with the next "
        "two.",
    )
    oidc_audience: str | None = Field(None, description="What these tokens are made for: their `aud`.")
    oidc_keys: str | None = Field(
        None,
        description="Public keys of the issuer, a JWK set: a file, which is read again when it changes, or an `https://` URL.",
    )
    oidc_scopes_claim: str = Field(
        "scope",
        min_length=1,
        description="Claim with the scopes: `panoloc:read`, `panoloc:localize`, `panoloc:write`, `panoloc:admin`, as a list or between "
        "spaces; dots lead into claims.",
    )
    oidc_tenant_claim: str = Field(
        "sub", min_length=1, description="Claim with the tenant, whose maps are seen; dots lead into claims."
    )

    @field_validator("oidc_issuer", "oidc_audience", "oidc_keys", mode="before")
    @classmethod
    def _empty_opens_nothing(cls, value: object) -> object:
        return None if value == "" else value

    @field_validator("oidc_keys")
    @classmethod
    def _signing_keys_can_be_trusted(cls, value: str | None) -> str | None:
        if value is not None and not is_url(value):
            try:
                keys_of(Path(value).read_bytes())
            except OSError as error:
                raise ValueError(f"expected a file that can be read, but {error}") from error
        return value

    @model_validator(mode="after")
    def _tokens_can_be_verified(self) -> Self:
        given = {"ISSUER": self.oidc_issuer, "AUDIENCE": self.oidc_audience, "KEYS": self.oidc_keys}
        missing = [f"PANOLOC_OIDC_{name}" for name, value in given.items() if value is None]
        if 0 < len(missing) < len(given):
            raise ValueError(f"expected {' and '.join(missing)} as well: tokens are verified by all three")
        return self

    def tokens(self) -> Tokens | None:
        """Return what verifies tokens, None where those of no issuer count."""
        if self.oidc_issuer is None or self.oidc_audience is None or self.oidc_keys is None:
            return None
        rules = TokenRules(self.oidc_issuer, self.oidc_audience, self.oidc_scopes_claim, self.oidc_tenant_claim)
        return Tokens(rules, SigningKeys(self.oidc_keys))
