"""Shares of maps: which worker scores which map of a query over many, so that each holds the retrieval vectors of its own ones alone."""

from collections import defaultdict
from collections.abc import Sequence
from functools import lru_cache
from hashlib import blake2b

from panoloc.service.jobs import MapRef

_KNOWN = 1 << 17  # maps


def shares_of(maps: Sequence[MapRef], num_shares: int) -> dict[int, tuple[MapRef, ...]]:
    """Return the maps of each share that has any. With one share more or fewer, only the maps of that one move."""
    shares = defaultdict[int, list[MapRef]](list)
    for ref in maps:
        shares[_share_of(ref.id, num_shares)].append(ref)
    return {number: tuple(part) for number, part in sorted(shares.items())}


@lru_cache(_KNOWN)
def _share_of(map_id: str, num_shares: int) -> int:
    """Return the share that wins the map (rendezvous hashing, Thaler and Ravishankar 1998)."""
    return max(range(num_shares), key=lambda number: blake2b(f"{map_id}/{number}".encode(), digest_size=8).digest())
