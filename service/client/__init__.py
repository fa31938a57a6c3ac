"""Clients of the HTTP API and their exceptions. `PanolocClient`, which programs use, is in `panoloc` itself; it loads pydantic."""

from panoloc.service.client.client import JsonClient
from panoloc.service.client.errors import (
    ApiProblemError,
    ClientError,
    InvalidKeyError,
    InvalidUrlError,
    MapFailedError,
    UnexpectedReplyError,
    UnreachableError,
    UntrustedError,
    WaitTimeoutError,
)
from panoloc.service.client.replies import JsonObject, UploadProgress

__all__ = [
    "ApiProblemError",
    "ClientError",
    "InvalidKeyError",
    "InvalidUrlError",
    "JsonClient",
    "JsonObject",
    "MapFailedError",
    "UnexpectedReplyError",
    "UnreachableError",
    "UntrustedError",
    "UploadProgress",
    "WaitTimeoutError",
]
