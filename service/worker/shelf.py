"""The maps of a worker: indexes and retrieval vectors in memory, and where they come from when they are not."""

import contextlib
import logging
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Generic, Protocol, TypeVar

from panoloc.core.errors import IndexFormatError
from panoloc.core.map.map_builder import index_config_digest
from panoloc.core.map.map_codec import decode_map_index
from panoloc.core.map.map_index import MapIndex
from panoloc.core.map.retrieval_vectors import (
    RetrievalVectors,
    decode_retrieval_vectors,
    encode_retrieval_vectors,
    retrieval_vectors,
)
from panoloc.service.cache import WorkerCache
from panoloc.service.errors import CacheDownError, MapNotFoundError, StorageError
from panoloc.service.jobs import MapRef
from panoloc.service.storage import Storage
from panoloc.service.worker.map_catalog import registration_of, store_vectors, stored_index, stored_vectors

_log = logging.getLogger(__name__)
_LOADED_AT_ONCE = 8
_VECTORS_SHARE = 3  # a third of the memory: of two gigabytes enough for those of 1,000 rooms


class _Sized(Protocol):
    @property
    def num_bytes(self) -> int:
        """Return how much memory it takes."""


Held = TypeVar("Held", bound=_Sized)
Found = TypeVar("Found")


class Resident(Generic[Held]):
    """What is held of maps, bounded by bytes; the least recently used make room. Not thread-safe: a worker asks in one thread."""

    def __init__(self, max_bytes: int) -> None:
        self._max_bytes = max_bytes
        self._held: dict[MapRef, Held] = {}  # the least recently used first
        self.num_bytes = 0

    def get(self, ref: MapRef) -> Held | None:
        """Return what is held of a map, None when nothing is; it becomes the most recently used."""
        if ref in self._held:
            self._held[ref] = self._held.pop(ref)
        return self._held.get(ref)

    def put(self, ref: MapRef, held: Held) -> None:
        """Hold something of a map of which nothing is held yet, unless it is larger than all room."""
        if held.num_bytes <= self._max_bytes:
            while self.num_bytes + held.num_bytes > self._max_bytes:
                self.num_bytes -= self._held.pop(next(iter(self._held))).num_bytes
            self._held[ref] = held
            self.num_bytes += held.num_bytes


class MissingIndexError(Exception):
    """Indexes of these maps have to be built again first."""

    def __init__(self, refs: Sequence[MapRef]) -> None:
        super().__init__(f"no index of {len(refs)} maps")
        self.refs = tuple(refs)


class Shelf:
    """Indexes and vectors of maps. max_bytes: of both in memory."""

    def __init__(self, storage: Storage, cache: WorkerCache, device: str, max_bytes: int) -> None:
        self._storage, self._cache, self._device = storage, cache, device
        self._vectors: Resident[RetrievalVectors] = Resident(max_bytes // _VECTORS_SHARE)
        self._indexes: Resident[MapIndex] = Resident(max_bytes - max_bytes // _VECTORS_SHARE)

    @property
    def num_bytes(self) -> int:
        """Return the bytes of everything in memory."""
        return self._indexes.num_bytes + self._vectors.num_bytes

    def indexes(self, refs: Sequence[MapRef], loads: Counter[str]) -> list[MapIndex]:
        """Return the indexes of maps. loads: counts where they came from, "resident", "redis" or "storage".

        A copy from storage goes back into Redis. Raises MissingIndexError for those that have to be built again.
        """
        found = {ref: index for ref in refs if (index := self._indexes.get(ref)) is not None}
        loads.update(["resident"] * len(found))
        absent = [ref for ref in refs if ref not in found]
        for ref, (source, index) in zip(absent, _in_threads(self._loaded, absent), strict=True):
            loads[source] += 1
            if index is not None:
                found[ref] = index
                self._indexes.put(ref, index)
        return _all_of(found, refs)

    def vectors(self, refs: Sequence[MapRef]) -> list[RetrievalVectors]:
        """Return the retrieval vectors of maps, made of the index where none are stored. Raises MissingIndexError."""
        found = {ref: vectors for ref in refs if (vectors := self._vectors.get(ref)) is not None}
        absent = [ref for ref in refs if ref not in found]
        for ref, vectors in zip(absent, _in_threads(self._loaded_vectors, absent), strict=True):
            if vectors is not None:
                found[ref] = vectors
                self._vectors.put(ref, vectors)
        return _all_of(found, refs)

    def _loaded(self, ref: MapRef) -> tuple[str, MapIndex | None]:
        """Return where the index came from, and the index; "missing" and None when it has to be built again."""
        digest = self._digest_of(ref)
        if digest is None:
            return "missing", None
        index = self._decoded(ref, self._cache.get_index(ref, digest))
        if index is not None:
            return "redis", index
        encoded = stored_index(self._storage, ref, digest)
        index = self._decoded(ref, encoded)
        if encoded is None or index is None:
            return "missing", None
        with contextlib.suppress(CacheDownError):  # a full Redis: the copy is as good
            self._cache.put_index(ref, digest, encoded)
        return "storage", index

    def _digest_of(self, ref: MapRef) -> str | None:
        """Return the digest of the configuration of an index; None where nobody can say, as whoever builds it again will find out."""
        try:
            return index_config_digest(registration_of(self._storage, ref).options.index)
        except (MapNotFoundError, StorageError) as error:
            _log.warning("the record of a map cannot be read", extra={"map_id": ref.id, "error": str(error)})
            return None

    def _decoded(self, ref: MapRef, encoded: bytes | None) -> MapIndex | None:
        """Return the index, None when it is missing or cannot be read."""
        if encoded is None:
            return None
        try:
            return decode_map_index(encoded, self._device)
        except IndexFormatError as error:
            _log.warning("a map index cannot be read", extra={"map_id": ref.id, "error": str(error)})
            return None

    def _loaded_vectors(self, ref: MapRef) -> RetrievalVectors | None:
        """Return the vectors, None when the index has to be built again first."""
        encoded = stored_vectors(self._storage, ref)
        try:
            if encoded is not None:
                return decode_retrieval_vectors(encoded, self._device)
        except IndexFormatError as error:
            _log.warning("retrieval vectors cannot be read", extra={"map_id": ref.id, "error": str(error)})
        # Not into Redis: of most maps nothing but their vectors is asked for.
        digest = self._digest_of(ref)
        index = None if digest is None else self._decoded(ref, stored_index(self._storage, ref, digest))
        if index is None:
            return None
        vectors = retrieval_vectors(index)
        store_vectors(self._storage, ref, encode_retrieval_vectors(vectors))
        return vectors


class QueryMaps:
    """The maps of one query, as `panoloc.core.many_maps.MapShelf` has them.

    loads: where their indexes came from. searched: those that were asked for, by number.
    """

    def __init__(self, shelf: Shelf, refs: Sequence[MapRef]) -> None:
        self._shelf, self._refs = shelf, refs
        self.loads: Counter[str] = Counter()
        self.searched: dict[int, MapIndex] = {}

    def __len__(self) -> int:
        return len(self._refs)

    def vectors(self) -> list[RetrievalVectors]:
        """Return the retrieval vectors of all maps."""
        return self._shelf.vectors(self._refs)

    def indexes(self, numbers: Sequence[int]) -> list[MapIndex]:
        """Return the indexes of some maps."""
        found = self._shelf.indexes([self._refs[number] for number in numbers], self.loads)
        self.searched |= zip(numbers, found, strict=True)
        return found


def _all_of(found: Mapping[MapRef, Held], refs: Sequence[MapRef]) -> list[Held]:
    """Return what was found of each map. Raises MissingIndexError for those of which nothing was."""
    if missing := [ref for ref in refs if ref not in found]:
        raise MissingIndexError(missing)
    return [found[ref] for ref in refs]


def _in_threads(work: Callable[[MapRef], Found], refs: Sequence[MapRef]) -> list[Found]:
    """Return what `work` returns for each map; most of the time is spent where other threads may go on."""
    with ThreadPoolExecutor(_LOADED_AT_ONCE) as threads:
        return list(threads.map(work, refs))
