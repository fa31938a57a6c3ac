"""The obstore client of a bucket: endpoint, credentials, timeouts and retries."""

from collections.abc import Mapping
from datetime import timedelta
from functools import cache
from typing import Any

from obstore.exceptions import BaseError, UnknownConfigurationKeyError
from obstore.store import AzureStore, GCSStore, ObjectStore, S3Store

from panoloc.service.errors import StorageAwayError
from panoloc.service.storage.urls import split_url

# Of one request; files are sent and fetched in pieces.
_TIMEOUT_S, _PROBE_TIMEOUT_S = 30.0, 5.0
_STORES: dict[str, Any] = {"s3": S3Store, "gs": GCSStore, "az": AzureStore}
# The URL names the bucket; obstore would let a variable override it.
_OF_THE_URL = frozenset(
    {"aws_bucket", "aws_bucket_name", "google_bucket", "google_bucket_name", "azure_container_name"}
)


def open_client(url: str, variables: Mapping[str, str], *, is_patient: bool = True) -> ObjectStore:
    """Return a client for the part of a bucket that a URL names.

    is_patient: retry for up to 20 s, for stored files; otherwise once within seconds, for readiness checks.
    Raises StorageAwayError for unusable variables.
    """
    scheme, rest = split_url(url)
    bucket, _, prefix = rest.partition("/")
    config = _known_variables(scheme, variables)
    endpoints = (value for name, value in config.items() if "endpoint" in name or "url" in name)
    options = {
        "timeout": timedelta(seconds=_TIMEOUT_S if is_patient else _PROBE_TIMEOUT_S),
        "connect_timeout": timedelta(seconds=5 if is_patient else 2),
        # Only where the operator wrote http://.
        "allow_http": any(value.startswith("http://") for value in endpoints),
    }
    retries = {
        "max_retries": 4 if is_patient else 1,
        "retry_timeout": timedelta(seconds=20 if is_patient else 3),
        "backoff": {"init_backoff": timedelta(milliseconds=100), "max_backoff": timedelta(seconds=5), "base": 2.0},
    }
    try:
        client: ObjectStore = _STORES[scheme](
            bucket, prefix=prefix.strip("/") or None, config=config, client_options=options, retry_config=retries
        )
    except (BaseError, ValueError) as error:
        raise StorageAwayError(
            f"expected variables for the access to {url}, but {str(error).splitlines()[0]}"
        ) from error
    return client


def _known_variables(scheme: str, variables: Mapping[str, str]) -> dict[str, str]:
    """Return the variables that obstore knows, in small letters; it refuses others, such as those of command lines."""
    named = {name.lower(): value for name, value in variables.items() if value}
    return {key: value for key, value in named.items() if key not in _OF_THE_URL and _is_known(scheme, key)}


@cache
def _is_known(scheme: str, key: str) -> bool:
    """Tell whether obstore knows a variable, which takes it milliseconds."""
    try:
        _STORES[scheme]("bucket", config={key: "1"})
    except UnknownConfigurationKeyError:
        return False
    except (BaseError, ValueError):
        pass  # known, and not enough by itself
    return True
