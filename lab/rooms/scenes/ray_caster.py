"""Open3D, which casts the rays of made-up rooms: the one thing that needs it today.

Loaded when the first rays are cast, because that takes a second and 130 MB; the service never loads it.
"""

from types import ModuleType

from core.errors import CoreError


class RayCasterMissingError(CoreError):
    """Open3D is not installed, or a system library that it loads is not."""


def load_open3d() -> ModuleType:
    """Return Open3D. Raises RayCasterMissingError, which says how to get it."""
    try:
        import open3d
    except (ImportError, OSError) as error:  # OSError: of a system library that Open3D loads
        raise RayCasterMissingError(
            f"expected Open3D, which renders made-up rooms, but it cannot be loaded ({error}); scripts/install installs it with "
            "the system libraries that it needs. The service, and scans of your own, work without it"
        ) from error
    module: ModuleType = open3d
    return module
