"""From a URL to the storage behind it, and what a bucket needs besides its URL."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from service.storage.folder import FolderStorage
from service.storage.protocol import Storage

# What the variables of each kind of bucket begin with; obstore knows them by these names.
_VARIABLES = {"s3": "AWS_", "gs": "GOOGLE_", "az": "AZURE_"}
BUCKET_SCHEMES = tuple(_VARIABLES)


@dataclass(frozen=True)
class BucketAccess:
    """What travels to every process that uses a bucket, also to other machines.

    local_folder: for uploads under way and local copies, made where there is none. copies_bytes: of local copies that are kept.
    variables: those of the environment that say where the bucket is and who we are; secrets are among them.
    """

    local_folder: str
    copies_bytes: int
    variables: Mapping[str, str] = field(default_factory=dict, repr=False)


def open_storage(url: str, access: BucketAccess | None = None) -> Storage:
    """Return the storage behind a path or a URL. access: of a bucket. Raises ValueError for what is neither."""
    scheme, _ = split_url(url)
    if scheme not in BUCKET_SCHEMES:
        return FolderStorage(folder_of(url))
    if access is None:
        raise ValueError(f"storage {url}: expected a folder for uploads and local copies with a bucket, got none")
    # Only here: workers and commands with a folder load nothing of it.
    from service.storage.bucket import BucketStorage

    return BucketStorage(url, access)


def split_url(url: str) -> tuple[str, str]:
    """Return the scheme, "" for a path, and the rest. Raises ValueError for a scheme that is not known, and for a bucket without name."""
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
        raise ValueError(f"expected no key in the URL: it belongs into variables that begin with {_VARIABLES[scheme]}")
    return scheme, rest


def folder_of(url: str) -> Path:
    """Return the folder that a path or a `file://` URL names."""
    return Path(split_url(url)[1])


def variables_of(url: str, environment: Mapping[str, str]) -> dict[str, str]:
    """Return the variables of the environment that are about the bucket of a URL; none for a folder."""
    prefix = _VARIABLES.get(split_url(url)[0])
    return {name: value for name, value in environment.items() if prefix is not None and name.startswith(prefix)}


def variables_of_buckets(environment: Mapping[str, str]) -> list[str]:
    """Return the names of the variables that could open a bucket, of whatever kind."""
    return [name for name in environment if name.startswith(tuple(_VARIABLES.values()))]
