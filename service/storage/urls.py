"""URLs of storages, and what a bucket needs besides its URL."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

# What the variables of each kind of bucket begin with; obstore knows them by these names.
_VARIABLES = {"s3": "AWS_", "gs": "GOOGLE_", "az": "AZURE_"}
BUCKET_SCHEMES = tuple(_VARIABLES)


@dataclass(frozen=True)
class BucketAccess:
    """What every process that uses a bucket gets, also on other machines.

    local_folder: for uploads under way and local copies, created on demand. copies_bytes: limit of the local copies.
    variables: those of the environment that name the endpoint and the credentials; they contain secrets.
    """

    local_folder: str
    copies_bytes: int
    variables: Mapping[str, str] = field(default_factory=dict, repr=False)


def split_url(url: str) -> tuple[str, str]:
    """Return the scheme, "" for a path, and the rest. Raises ValueError for an unknown scheme or a missing bucket."""
    scheme, separator, rest = url.partition("://")
    if not separator:
        return "", url
    if scheme == "file" and rest.startswith("/"):
        return scheme, rest
    if scheme not in BUCKET_SCHEMES or not rest.partition("/")[0]:
        raise ValueError(
            "expected s3://bucket/prefix, gs://bucket/prefix, az://container/prefix or file:///folder, got "
            f"{url if '@' not in url else scheme + '://…'}"
        )
    if "@" in rest:
        raise ValueError(f"expected no key in the URL: put it into variables that begin with {_VARIABLES[scheme]}")
    return scheme, rest


def folder_of(url: str) -> Path:
    """Return the folder that a path or a `file://` URL names."""
    return Path(split_url(url)[1])


def variables_of(url: str, environment: Mapping[str, str]) -> dict[str, str]:
    """Return the variables of the environment that are about the bucket of a URL; none for a folder."""
    prefix = _VARIABLES.get(split_url(url)[0])
    return {name: value for name, value in environment.items() if prefix is not None and name.startswith(prefix)}


def variables_of_buckets(environment: Mapping[str, str]) -> list[str]:
    """Return the names of the variables that could open a bucket of any kind."""
    return [name for name in environment if name.startswith(tuple(_VARIABLES.values()))]
