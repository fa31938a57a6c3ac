"""The maps that one caller sees: a registry as if there were no others."""

from typing import TYPE_CHECKING

from service.errors import MapNotFoundError
from service.maps.record import MapRecord

if TYPE_CHECKING:
    from service.maps.known_maps import KnownMaps


class VisibleMaps:
    """A view for reading. tenant: None sees all maps."""

    def __init__(self, registry: "KnownMaps", tenant: str | None) -> None:
        self._registry = registry
        self.tenant = tenant

    def get(self, map_id: str) -> MapRecord:
        """Return a map. Raises MapNotFoundError, in the same words for one of others."""
        if not self.has(map_id):
            others = "" if self.tenant is None else ", or of others who have not shared it with this key (shared_with)"
            raise MapNotFoundError(
                f"expected the id of a map, got {map_id[:80]!r}, which is unknown or deleted{others}; GET /maps lists the maps"
            )
        return self._registry.get(map_id)

    def has(self, map_id: str) -> bool:
        """Tell whether there is a map under this id."""
        return self._registry.has(map_id) and self._registry.get(map_id).is_seen_by(self.tenant)

    def all(self) -> list[MapRecord]:
        """Return all maps, oldest first."""
        return [record for record in self._registry.all() if record.is_seen_by(self.tenant)]

    def with_tag(self, tag: str) -> list[MapRecord]:
        """Return the maps that bear a tag, oldest first."""
        return [record for record in self.all() if tag in record.tags]
