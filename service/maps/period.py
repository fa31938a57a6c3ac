"""Periods of time, as callers give them."""

from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, date, datetime, time

from panoloc.service.errors import InvalidOptionsError


@dataclass(frozen=True)
class Period:
    """The answers from `since` to `until`, which have a time zone; None: from the first that still counts, to the last."""

    since: datetime | None = None
    until: datetime | None = None

    @classmethod
    def between(cls, since: str | None, until: str | None) -> "Period":
        """Return the period between two times (RFC 3339), or days (UTC), which count whole. Raises InvalidOptionsError."""
        period = cls(_time_of("since", since, time.min), _time_of("until", until, time.max))
        if period.since is not None and period.until is not None and period.since > period.until:
            raise InvalidOptionsError.of(
                "since", f"expected a time before until, got {since} after {until}; exchange them, or leave one out"
            )
        return period

    def has(self, moment: datetime) -> bool:
        """Tell whether a time lies in the period."""
        return (self.since is None or moment >= self.since) and (self.until is None or moment <= self.until)


ALWAYS = Period()


def _time_of(field: str, text: str | None, of_day: time) -> datetime | None:
    """Return a time; of_day: for a date alone."""
    if text is None:
        return None
    with suppress(ValueError):
        return datetime.combine(date.fromisoformat(text), of_day, UTC)
    with suppress(ValueError):
        if (found := datetime.fromisoformat(text)).tzinfo is not None:
            return found
    raise InvalidOptionsError.of(
        field,
        "expected a date such as 2026-11-21, or a time with its zone such as 2026-11-21T12:00:00Z (in a URL, a + is "
        f"%2B), got {text[:40]!r}",
    )
