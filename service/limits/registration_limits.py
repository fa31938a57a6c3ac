"""How long a registration may take, and how much memory: more for a larger scan."""

from dataclasses import dataclass

MAX_COUNTED_BYTES = 4 * 2**30
"""The unpacked bytes of an archive that raise its limits, at most: as many as the largest upload has by default."""

MAX_ATTEMPTS = 5
"""Attempts of one registration, counted over restarts of the service: a scan that ends its process does so again."""


@dataclass(frozen=True)
class RegistrationLimits:
    """Limits that grow with the bytes of the scan's file, or of an archive's content.

    The largest scan that was measured, 50 million points in 750 MB, takes minutes and less than 2 GB; a small one
    seconds.
    """

    time_s: float = 600.0
    time_s_per_mb: float = 2.0
    memory_bytes: int = 4 * 2**30
    memory_per_scan_byte: float = 8.0

    def seconds(self, scan_bytes: int) -> float:
        """Return the seconds that a registration may take once it runs."""
        return self.time_s + self.time_s_per_mb * scan_bytes / 1e6

    def bytes(self, scan_bytes: int) -> int:
        """Return the bytes that the process of a registration may allocate."""
        return self.memory_bytes + int(self.memory_per_scan_byte * scan_bytes)
