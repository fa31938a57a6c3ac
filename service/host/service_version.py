"""Which panoloc this is."""

from importlib.metadata import PackageNotFoundError, version


def service_version() -> str:
    """Return the version that is installed."""
    try:
        return version("panoloc")
    except PackageNotFoundError:
        return "unknown"
