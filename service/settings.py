"""Everything that an operator may set, read from environment variables with the prefix `PANOLOC_`."""

import os
from functools import cached_property
from pathlib import Path
from typing import Literal, Self

from pydantic import AliasChoices, Field, field_validator, model_validator
from pydantic_settings import SettingsConfigDict

from core.options import MAX_PIXELS, Method, ScanOptions
from service.host_names import host_names
from service.jobs import PAPER_TIMEOUT_S
from service.keys.key_ring import KeyRing
from service.keys.setting import callers_of_setting
from service.keys.token_settings import TokenSettings
from service.limits.connection_limits import ConnectionLimits
from service.limits.registration_limits import RegistrationLimits
from service.storage.urls import BUCKET_SCHEMES, BucketAccess, folder_of, split_url, variables_of


class Settings(TokenSettings):
    """Settings of one service. Arguments win over the environment; raises pydantic.ValidationError."""

    model_config = SettingsConfigDict(env_prefix="PANOLOC_", populate_by_name=True, frozen=True, extra="ignore")

    host: str = Field("127.0.0.1", description="Address to listen on; `0.0.0.0` for all.")
    port: int = Field(8000, ge=0, le=65535, description="Port to listen on.")
    data_dir: Path = Field(
        Path("panoloc-data"),
        description="Folder for scans, map records and batches, which must not be lost, and for keys and the audit log.",
    )
    storage: str | None = Field(
        None,
        description="Bucket for scans, map records and batches in place of the data folder: `s3://bucket/prefix`, `gs://bucket/prefix`, "
        "`az://container/prefix`; or another folder, `file:///folder`.",
    )
    local_copies_bytes: int = Field(
        4 * 2**30,
        ge=0,
        description="Bytes of files of a bucket that are kept in the data folder, so that they need not be fetched again.",
    )
    shared: bool = Field(
        False,
        description="Other services use the same data folder or bucket and the same Redis: several front doors behind a balancer.",
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
        1, ge=1, description="Scans read at the same time; each takes the memory of a whole scan."
    )
    registration_time_s: float = Field(
        RegistrationLimits.time_s, gt=0, description="Seconds that a registration may take once it runs, of any scan."
    )
    registration_time_s_per_mb: float = Field(
        RegistrationLimits.time_s_per_mb, ge=0, description="Seconds more for each megabyte of the scan."
    )
    registration_memory_bytes: int = Field(
        RegistrationLimits.memory_bytes, ge=2**28, description="Bytes that a registration may allocate, of any scan."
    )
    registration_memory_per_scan_byte: float = Field(
        RegistrationLimits.memory_per_scan_byte, ge=0, description="Bytes more for each byte of the scan."
    )
    max_upload_bytes: int = Field(4 * 2**30, ge=1, description="Bytes of one uploaded scan.")
    max_image_bytes: int = Field(
        64 * 2**20,
        ge=1,
        description="Bytes of one uploaded image or mask; the images of one query together may take four times as many.",
    )
    max_pixels: int = Field(
        MAX_PIXELS, ge=1, description="Pixels of all images of one query together; checked before they are decoded."
    )
    max_points: int = Field(ScanOptions.max_points, ge=1, description="Points of a scan; a scan with more is refused.")
    max_points_used: int = Field(
        ScanOptions.max_points_used, ge=1, description="Points of a scan that remain after thinning."
    )
    max_connections: int = Field(1024, ge=1, description="Connections at the same time; the next one gets 503.")
    max_connections_per_address: int = Field(
        256, ge=1, description="Connections of one address; a proxy in front has one address for all its clients."
    )
    max_header_bytes: int = Field(
        16_384, ge=1024, description="Bytes of a request's path and headers together; beyond that 431."
    )
    header_timeout_s: float = Field(
        10.0, gt=0, description="Seconds from the start of a connection or request to the end of its headers; then 408."
    )
    transfer_timeout_s: float = Field(
        30.0, gt=0, description="Seconds that a body, or the reading of an answer, may be slower than the next setting."
    )
    min_bytes_per_s: float = Field(
        1024.0,
        gt=0,
        description="Bytes per second of a body on average; slower ones get 408, slow readers are cut off.",
    )
    max_bytes_in_flight: int = Field(
        512 * 2**20, ge=1, description="Bytes of the images of all queries that are not yet answered; beyond that 503."
    )
    max_bytes_in_flight_per_caller: int = Field(
        384 * 2**20, ge=1, description="Of these, bytes of one caller: an API key where keys are set, else an address."
    )
    max_requests_per_minute: int | None = Field(
        None,
        ge=1,
        description="Requests of one caller in a minute, through all front doors; then 429. Health and the console's files are free.",
    )
    max_bytes_per_hour: int | None = Field(
        None, ge=1, description="Bytes that one caller may send in an hour; the next upload after them gets 429."
    )
    max_uploads: int = Field(16, ge=1, description="Uploads of scans and batches at the same time; beyond that 503.")
    max_uploads_per_caller: int = Field(8, ge=1, description="Of these, uploads of one caller.")
    export_time_s: float = Field(600.0, gt=0, description="Seconds that an export or a plan of a batch may take.")
    max_maps: int = Field(1000, ge=1, description="Maps at the same time.")
    max_batches: int = Field(100, ge=1, description="Batches at the same time; each lives until it is deleted.")
    max_batch_images: int = Field(2000, ge=1, description="Images of one batch.")
    queue_limit: int = Field(64, ge=0, description="Queries that may wait for a worker; the next one gets 429.")
    default_timeout_s: float = Field(
        60.0,
        gt=0,
        description="Seconds for a query that names no `timeout_s` itself, at least "
        f"{PAPER_TIMEOUT_S:g} for `method: paper` and for `hfov_range_deg`; as far as the next setting allows.",
    )
    max_timeout_s: float = Field(PAPER_TIMEOUT_S, gt=0, description="Longest `timeout_s` that a query may ask for.")
    result_ttl_s: int = Field(3600, ge=1, description="Seconds for which answers and their pictures can be fetched.")
    changes_ttl_s: int = Field(
        30 * 24 * 3600,
        ge=0,
        description="Seconds for which `GET /maps/{id}/changes` counts what an answer saw; 0 keeps none of it.",
    )
    index_ttl_s: int = Field(
        30 * 24 * 3600, ge=60, description="Seconds for which Redis keeps a map index after its last use."
    )
    resident_bytes: int = Field(2 * 2**30, ge=0, description="Bytes of map indexes that each worker keeps in memory.")
    drain_s: float = Field(30.0, ge=0, description="Seconds that requests under way may take after SIGTERM.")
    api_keys: str = Field(
        "",
        repr=False,
        description="Keys that callers have to present, besides those of `panoloc keys`: `key` for everything, `key:read` for all but "
        "changing maps, `key:localize` for queries alone; separated by commas, each of at least 8 characters. Without any key none is "
        "asked for.",
    )
    allowed_hosts: str = Field(
        "",
        description="Without keys: names under which the service is reached, besides addresses, `localhost` and the machine's own name, "
        "separated by commas; `*` for all.",
    )
    open_pages: bool = Field(
        False,
        description="With keys set: answer `/metrics`, `/docs`, `/openapi.json` and the details of `/health` without one.",
    )
    keep_images: bool = Field(False, description="Keep uploaded images in the data folder, in `panoramas/`.")
    log_level: Literal["debug", "info", "warning", "error"] = Field("info", description="How much to log.")
    log_format: Literal["console", "json"] = Field("console", description="Log for people, or one JSON object a line.")

    @field_validator(
        "redis_url", "ray_address", "storage", "max_requests_per_minute", "max_bytes_per_hour", mode="before"
    )
    @classmethod
    def _empty_means_unset(cls, value: object) -> object:
        return None if value == "" else value

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

    @field_validator("allowed_hosts")
    @classmethod
    def _hosts_are_names(cls, value: str) -> str:
        return ",".join(host_names(value))

    @model_validator(mode="after")
    def _sharing_is_possible(self) -> Self:
        if self.shared and self.redis_url is None:
            raise ValueError("expected PANOLOC_REDIS_URL with PANOLOC_SHARED: all front doors need the same Redis")
        return self

    @cached_property
    def keys(self) -> KeyRing:
        """Return what decides which key counts: those of `api_keys`, those that `panoloc keys` has made, and tokens."""
        return KeyRing(self.api_keys, self.data_dir, self.tokens())

    def timeout_s_of(self, method: Method, is_searching_field_of_view: bool = False) -> float:
        """Return the seconds for a query of this method that names none itself; more where a field of view is searched as well."""
        is_long = method == "paper" or is_searching_field_of_view
        wanted = max(self.default_timeout_s, PAPER_TIMEOUT_S) if is_long else self.default_timeout_s
        return min(wanted, self.max_timeout_s)

    @property
    def connection_limits(self) -> ConnectionLimits:
        """Return what a connection may take."""
        return ConnectionLimits(
            self.max_connections,
            self.max_connections_per_address,
            self.max_header_bytes,
            self.header_timeout_s,
            self.transfer_timeout_s,
            self.min_bytes_per_s,
        )

    @property
    def registration_limits(self) -> RegistrationLimits:
        """Return what a registration may take."""
        return RegistrationLimits(
            self.registration_time_s,
            self.registration_time_s_per_mb,
            self.registration_memory_bytes,
            self.registration_memory_per_scan_byte,
        )

    @property
    def storage_url(self) -> str:
        """Return where scans and map records live, for `service.storage.open_storage`."""
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
        """Return what processes need to use the bucket, None without one. The environment is read when this is asked for first."""
        if not self.has_bucket:
            return None
        variables = variables_of(self.storage_url, os.environ)
        return BucketAccess(str(self.data_dir.resolve()), self.local_copies_bytes, variables)
