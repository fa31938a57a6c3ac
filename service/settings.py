"""Everything that an operator may set, read from environment variables with the prefix `PANOLOC_`."""

import os
import ssl
from functools import cached_property
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, AliasChoices, BeforeValidator, Field, field_validator, model_validator
from pydantic_settings import BaseSettings, SettingsConfigDict

from panoloc.core.options import MAX_PIXELS, Method, ScanOptions
from panoloc.service.host_names import host_names, origins
from panoloc.service.jobs import PAPER_TIMEOUT_S
from panoloc.service.keys.key_ring import KeyRing, callers_of_setting
from panoloc.service.keys.tokens import IssuerKeys, Tokens, is_url, read_keys
from panoloc.service.limits.registration_limits import RegistrationLimits
from panoloc.service.storage.urls import BUCKET_SCHEMES, BucketAccess, folder_of, split_url, variables_of

# Of files of a bucket that the data folder keeps, so that they need not be fetched again.
_LOCAL_COPIES_BYTES = 4 * 2**30


class Settings(BaseSettings):
    """Settings of one service. Arguments win over the environment; raises pydantic.ValidationError."""

    model_config = SettingsConfigDict(
        env_prefix="PANOLOC_", env_ignore_empty=True, populate_by_name=True, frozen=True, extra="ignore"
    )

    host: str = Field("127.0.0.1", description="Address to listen on; `0.0.0.0` for all.")
    port: int = Field(8000, ge=0, le=65535, description="Port to listen on.")
    tls_cert: Path | None = Field(
        None,
        description="Certificate (PEM, with its chain): the service speaks HTTPS. `panoloc certificate` makes one.",
    )
    tls_key: Path | None = Field(None, description="Private key of the certificate (PEM).")
    data_dir: Path = Field(
        Path("panoloc-data"),
        description="Folder for all durable data: scans, map records, batches, keys and the audit log.",
    )
    storage: str | None = Field(
        None,
        description="Bucket for scans, map records and batches in place of the data folder: `s3://bucket/prefix`, "
        "`gs://bucket/prefix`, `az://container/prefix`; or another folder, `file:///folder`.",
    )
    shared: bool = Field(
        False,
        description="Other services use the same data folder or bucket and the same Redis: several API replicas behind "
        "a balancer.",
    )
    redis_url: str | None = Field(None, description="Redis to use; without it the service starts its own.")
    ray_address: str | None = Field(
        None,
        validation_alias=AliasChoices("panoloc_ray_address", "ray_address"),
        description="Ray cluster whose workers answer queries (`panoloc workers`); without it the service runs its own.",
    )
    num_workers: int | None = Field(
        None, ge=1, description="Workers that answer queries; one per GPU, else one per CPU socket."
    )
    num_registrations: int = Field(
        1, ge=1, description="Concurrent registrations; each needs the memory of a whole scan."
    )
    registration_memory_bytes: int = Field(
        RegistrationLimits.memory_bytes,
        ge=2**28,
        description=f"Bytes that a registration may allocate, plus {RegistrationLimits.memory_per_scan_byte:g} for "
        "each byte of the scan.",
    )
    max_upload_bytes: int = Field(4 * 2**30, ge=1, description="Bytes of one uploaded scan.")
    max_image_bytes: int = Field(
        64 * 2**20,
        ge=1,
        description="Bytes of one uploaded image or mask; the images of one query together may take four times as "
        "many.",
    )
    max_pixels: int = Field(
        MAX_PIXELS, ge=1, description="Pixels of all images of one query together; checked before decoding."
    )
    max_points: int = Field(ScanOptions.max_points, ge=1, description="Points of a scan; a scan with more is refused.")
    max_points_used: int = Field(
        ScanOptions.max_points_used, ge=1, description="Points of a scan that remain after thinning."
    )
    max_requests_per_minute: int | None = Field(
        None,
        ge=1,
        description="Requests of one caller per minute, over all API replicas; beyond that 429. Health and the "
        "console's files are exempt.",
    )
    max_bytes_per_hour: int | None = Field(
        None, ge=1, description="Bytes that one caller may send per hour; the next upload gets 429."
    )
    max_maps: int = Field(1000, ge=1, description="Largest number of maps.")
    search_all: bool = Field(
        False, description="Whether a query that names neither maps nor a tag searches all maps that its key sees."
    )
    max_batch_images: int = Field(2000, ge=1, description="Images of one batch.")
    queue_limit: int = Field(64, ge=0, description="Queries that may wait for a worker; the next one gets 429.")
    default_timeout_s: float = Field(
        60.0,
        gt=0,
        description="Default `timeout_s` of a query, at least "
        f"{PAPER_TIMEOUT_S:g} for `method: paper` and for `hfov_range_deg`; the next setting limits it.",
    )
    max_timeout_s: float = Field(PAPER_TIMEOUT_S, gt=0, description="Longest `timeout_s` that a query may request.")
    result_ttl_s: int = Field(3600, ge=1, description="Lifetime of answers and their pictures, in seconds.")
    index_ttl_s: int = Field(
        30 * 24 * 3600, ge=60, description="Seconds for which Redis keeps a map index after its last use."
    )
    resident_bytes: int = Field(
        2 * 2**30, ge=0, description="Bytes of map indexes and retrieval vectors that each worker keeps in memory."
    )
    drain_s: float = Field(30.0, ge=0, description="Seconds that running requests may take after SIGTERM.")
    api_keys: str = Field(
        "",
        repr=False,
        description="API keys, besides those of `panoloc keys`: `key` allows everything, `key:read` all except "
        "changing maps, `key:localize` queries only; separated by commas, each of at least 8 characters. Without any "
        "key the service requires none.",
    )
    oidc_issuer: str | None = Field(
        None,
        description="Issuer (`iss`) of OpenID Connect tokens, which work like keys; verified without calling the "
        "issuer. Needs the next two.",
    )
    oidc_audience: str | None = Field(None, description="Audience (`aud`) of these tokens.")
    oidc_keys: str | None = Field(
        None,
        description="Public keys of the issuer as a JWK set: a file, reread when it changes, or an `https://` URL.",
    )
    oidc_scopes_claim: str = Field(
        "scope",
        min_length=1,
        description="Claim with the scopes: `panoloc:read`, `panoloc:localize`, `panoloc:write`, `panoloc:admin`, as "
        "a list or separated by spaces; dots separate nested claims.",
    )
    oidc_tenant_claim: str = Field(
        "sub", min_length=1, description="Claim with the caller's tenant; dots separate nested claims."
    )
    allowed_hosts: Annotated[str, AfterValidator(lambda text: ",".join(host_names(text)))] = Field(
        "",
        description="Without keys: host names of the service, besides addresses, `localhost` and the machine's own "
        "name; separated by commas; `*` for all.",
    )
    allowed_origins: Annotated[str, AfterValidator(lambda text: ",".join(origins(text)))] = Field(
        "",
        description="Origins of web pages that may call the service from browsers, such as `https://app.example.org`; separated by "
        "commas; `*` for all.",
    )
    keep_images: bool = Field(False, description="Keep uploaded images in the data folder, in `panoramas/`.")
    log_level: Annotated[
        Literal["debug", "info", "warning", "error"], BeforeValidator(lambda text: str(text).lower())
    ] = Field("info", description="Log level.")
    log_format: Literal["console", "json"] = Field("console", description="Readable log, or one JSON object per line.")

    @model_validator(mode="after")
    def _certificate_fits_its_key(self) -> Self:
        if (self.tls_cert is None) != (self.tls_key is None):
            raise ValueError("expected both PANOLOC_TLS_CERT and PANOLOC_TLS_KEY, or neither")
        if self.tls_cert is not None:
            try:
                ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(self.tls_cert, self.tls_key, password="")
            except (OSError, ValueError) as error:
                raise ValueError(
                    f"expected a certificate and its key without a password in {self.tls_cert} and {self.tls_key}: {error}"
                ) from error
        return self

    @field_validator("storage")
    @classmethod
    def _storage_is_a_url(cls, value: str | None) -> str | None:
        if value is not None and not split_url(value)[0]:
            raise ValueError("expected s3://bucket/prefix or another URL; PANOLOC_DATA_DIR names a folder")
        return value

    @field_validator("api_keys")
    @classmethod
    def _keys_can_be_read(cls, value: str) -> str:
        callers_of_setting(value)
        return value

    @field_validator("oidc_keys")
    @classmethod
    def _issuer_keys_can_be_read(cls, value: str | None) -> str | None:
        try:
            if value is not None and not is_url(value):
                read_keys(value)
        except OSError as error:
            raise ValueError(f"expected a file that can be read, but {error}") from error
        return value

    @model_validator(mode="after")
    def _tokens_can_be_verified(self) -> Self:
        given = {"ISSUER": self.oidc_issuer, "AUDIENCE": self.oidc_audience, "KEYS": self.oidc_keys}
        missing = [f"PANOLOC_OIDC_{name}" for name, value in given.items() if value is None]
        if 0 < len(missing) < len(given):
            raise ValueError(f"expected {' and '.join(missing)} as well: verifying tokens needs all three")
        return self

    @model_validator(mode="after")
    def _sharing_is_possible(self) -> Self:
        if self.shared and self.redis_url is None:
            raise ValueError("expected PANOLOC_REDIS_URL with PANOLOC_SHARED: all API replicas need the same Redis")
        return self

    @cached_property
    def keys(self) -> KeyRing:
        """Return the keys that count: those of `api_keys`, those that `panoloc keys` has made, and tokens."""
        return KeyRing(self.api_keys, self.data_dir, self._tokens())

    def _tokens(self) -> Tokens | None:
        if self.oidc_issuer is None or self.oidc_audience is None or self.oidc_keys is None:
            return None
        keys = IssuerKeys(self.oidc_keys)
        return Tokens(self.oidc_issuer, self.oidc_audience, self.oidc_scopes_claim, self.oidc_tenant_claim, keys)

    def timeout_s_of(self, method: Method, is_searching_field_of_view: bool = False) -> float:
        """Return the seconds for a query of this method that names none itself; more where a field of view is searched
        as well."""
        is_long = method == "paper" or is_searching_field_of_view
        wanted = max(self.default_timeout_s, PAPER_TIMEOUT_S) if is_long else self.default_timeout_s
        return min(wanted, self.max_timeout_s)

    @property
    def registration_limits(self) -> RegistrationLimits:
        """Return what a registration may take."""
        return RegistrationLimits(memory_bytes=self.registration_memory_bytes)

    @property
    def storage_url(self) -> str:
        """Return where scans and map records live, for `panoloc.service.storage.open_storage`."""
        if self.has_bucket:
            return str(self.storage)
        return str(self.storage_folder)

    @property
    def has_bucket(self) -> bool:
        """Tell whether scans and map records live in a bucket, and not in a folder."""
        return self.storage is not None and split_url(self.storage)[0] in BUCKET_SCHEMES

    @property
    def storage_folder(self) -> Path:
        """Return the folder in which scans and map records live; with a bucket, the data folder."""
        is_elsewhere = self.storage is not None and not self.has_bucket
        return folder_of(self.storage).resolve() if self.storage and is_elsewhere else self.data_dir.resolve()

    @cached_property
    def bucket_access(self) -> BucketAccess | None:
        """Return what processes need to use the bucket, None without one. The environment is read when this is asked
        for first."""
        if not self.has_bucket:
            return None
        variables = variables_of(self.storage_url, os.environ)
        return BucketAccess(str(self.data_dir.resolve()), _LOCAL_COPIES_BYTES, variables)
