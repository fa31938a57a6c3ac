"""Who a request comes from, and what that caller may do and see."""

from dataclasses import dataclass
from typing import Literal, get_args

Scope = Literal["read", "localize", "write", "admin"]
"""read: maps, health, metrics and documentation. localize: queries and batches. write: to add, change and delete maps.
admin: all of this with the maps and batches of every tenant."""

ALL_SCOPES: frozenset[Scope] = frozenset(get_args(Scope))


@dataclass(frozen=True)
class Caller:
    """id: for limits and the audit log, such as "key key_…" or "address …". tenant: whose maps are seen; None: all."""

    id: str
    scopes: frozenset[Scope]
    tenant: str | None = None
