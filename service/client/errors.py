"""The exceptions of the client.

    ClientError
    ├── InvalidUrlError         the URL is not valid
    ├── InvalidKeyError         the key is not valid
    ├── UnreachableError        nobody answers at the URL
    ├── UntrustedError          its certificate is not trusted
    ├── UnexpectedReplyError    something answers, but not this service
    ├── ApiProblemError         the service answered with a problem document (RFC 9457)
    ├── MapFailedError          the scan was accepted but could not become a map
    └── WaitTimeoutError        the client stopped waiting

Every message says what was expected, what came, and what to do.
"""

from typing import Any


class ClientError(Exception):
    """Base of all exceptions of the client."""

    def as_dict(self) -> dict[str, Any]:
        """Return the error as a JSON-safe object with `type` and `detail`."""
        return {"type": type(self).__name__, "detail": str(self)}


class UnreachableError(ClientError):
    """Nobody answers at the URL of the service."""

    def __init__(self, url: str, reason: str) -> None:
        super().__init__(f"No service answers at {url} ({reason}).")
        self.url = url


class UntrustedError(ClientError):
    """The certificate of the service is not trusted."""

    def __init__(self, url: str) -> None:
        super().__init__(
            f"Expected a certificate for {url} from an authority that is trusted, got another; for one of `panoloc certificate` set "
            "SSL_CERT_FILE to its ca.crt."
        )


class InvalidUrlError(ClientError):
    """The URL of the service is not valid."""


class InvalidKeyError(ClientError):
    """The key cannot be sent in a header."""


class UnexpectedReplyError(ClientError):
    """Something other than panoloc answers at the URL."""


class MapFailedError(ClientError):
    """The scan was stored, but the registration failed.

    serving_revision: the older revision that still answers queries, None without one.
    """

    def __init__(self, map_id: str, reason: str, serving_revision: int | None = None) -> None:
        still = "" if serving_revision is None else f", revision {serving_revision} still answers"
        super().__init__(f"Map {map_id} failed{still}: {reason}")
        self.map_id = map_id
        self.serving_revision = serving_revision


class WaitTimeoutError(ClientError):
    """The client stopped waiting; the work may still go on."""


class ApiProblemError(ClientError):
    """The service answered with an error.

    status: HTTP status. problem: the problem document (`type`, `title`, `detail`, `request_id`, perhaps more).
    retry_after_s: seconds until a retry makes sense, None when the service does not say.
    """

    def __init__(self, status: int, problem: dict[str, Any], retry_after_s: float | None = None) -> None:
        self.status = status
        self.problem = problem
        self.retry_after_s = retry_after_s
        super().__init__(str(problem.get("detail") or problem.get("title") or f"HTTP status {status}"))

    @property
    def title(self) -> str:
        """Return the short name of the problem."""
        return str(self.problem.get("title") or f"HTTP {self.status}")

    def as_dict(self) -> dict[str, Any]:
        """Return the problem document with its status."""
        return {**self.problem, "status": self.status}
