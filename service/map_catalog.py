"""What a worker asks of storage."""

from contextlib import AbstractContextManager
from pathlib import Path
from typing import Protocol

from service.pool import MapRef, RegisterJob


class MapCatalog(Protocol):
    """The registered maps and their scans."""

    def registration_of(self, map_ref: MapRef) -> RegisterJob:
        """Return how a map was registered. Raises a service error when it is unknown."""

    def scan_file(self, job: RegisterJob) -> AbstractContextManager[Path]:
        """Return the scan as a local file for the duration of a block. Raises a service error when it is damaged."""
