"""How often a registration may begin, so that a scan that ends the service each time does not do so for ever."""

from dataclasses import replace

from service.errors import RegistrationLimitError
from service.jobs import MapRef
from service.limits.registration_limits import MAX_ATTEMPTS
from service.maps.record import MapRecord
from service.maps.registry import MapRegistry


class Attempts:
    """Counts in the records. Used from one event loop."""

    def __init__(self, registry: MapRegistry) -> None:
        self._registry = registry
        # Counted and not ended.
        self._under_way: set[MapRef] = set()

    async def begin(self, ref: MapRef) -> None:
        """Note that a registration begins, before it can end the service. Raises RegistrationLimitError after too many."""
        if self._registry.get(ref.id).newest.num_attempts >= MAX_ATTEMPTS:
            raise RegistrationLimitError(
                f"expected a map after {MAX_ATTEMPTS} attempts at most, but the service ended during each; upload a smaller scan, or "
                "one in another format"
            )
        self._under_way.add(ref)
        await self._count(ref, 1)

    async def take_back(self, ref: MapRef) -> None:
        """Let an attempt that an orderly stop ended be none."""
        if ref in self._under_way:
            await self._count(ref, -1)

    def end(self, ref: MapRef) -> None:
        """Note that an attempt has come to its end, whichever."""
        self._under_way.discard(ref)

    async def _count(self, ref: MapRef, step: int) -> None:
        def counted(record: MapRecord) -> MapRecord:
            newest = replace(record.newest, num_attempts=max(0, record.newest.num_attempts + step))
            return replace(record, newest=newest)

        await self._registry.change_newest(ref, counted)
