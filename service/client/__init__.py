"""A client of the HTTP API for programs: `PanolocClient` and its exceptions."""

from panoloc.service.client.client import JsonObject, PanolocClient, UploadProgress
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

__all__ = [
    "ApiProblemError",
    "ClientError",
    "InvalidKeyError",
    "InvalidUrlError",
    "JsonObject",
    "MapFailedError",
    "PanolocClient",
    "UnexpectedReplyError",
    "UnreachableError",
    "UntrustedError",
    "UploadProgress",
    "WaitTimeoutError",
]
