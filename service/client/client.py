"""A client of the HTTP API that needs neither torch nor the algorithm. Its two kinds differ in what they return: `JsonClient` documents as
the service sends them, `panoloc.service.client.typed_client.PanolocClient` models of them.

Uploads are streamed from disk. All methods raise the classes of `panoloc.service.client.errors`.
"""

import json
import re
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, nullcontext
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Generic, Self, TypeVar
from urllib.parse import quote, urlsplit

import httpx

from panoloc.service.client.errors import (
    ApiProblemError,
    ClientError,
    InvalidKeyError,
    InvalidUrlError,
    MapFailedError,
    UnreachableError,
    UntrustedError,
    WaitTimeoutError,
)
from panoloc.service.client.replies import JsonObject, ProgressFile, UploadProgress, json_object, raise_problem, reason

MapT = TypeVar("MapT")
AnswerT = TypeVar("AnswerT")

CONNECT_TIMEOUT_S = 5.0
READ_TIMEOUT_S = 60.0
# The service stores a large scan durably after its last byte has arrived.
UPLOAD_READ_TIMEOUT_S = 600.0
# The service answers 504 at the deadline; the client waits a little longer for that.
DEADLINE_MARGIN_S = 30.0
POLL_FIRST_S, POLL_LONGEST_S = 0.1, 2.0
_KEY = re.compile(r"[!-~]+")


class BaseClient(ABC, Generic[MapT, AnswerT]):
    """Calls one running service. A file that cannot be read raises OSError, as `open` does.

    url: where it listens, without a trailing path. api_key: sent as a bearer token when given.
    transport: replaces the network, for tests. Raises InvalidUrlError, InvalidKeyError.
    """

    def __init__(self, url: str, api_key: str | None = None, transport: httpx.BaseTransport | None = None) -> None:
        self.url = url.rstrip("/")
        _check_url(url)
        _check_key(api_key)
        headers = {"Accept": "application/json"} | ({"Authorization": f"Bearer {api_key}"} if api_key else {})
        # No proxy from the environment for calls to this machine.
        direct = {f"all://{host}": None for host in ("127.0.0.1", "localhost", "[::1]")}
        timeout = httpx.Timeout(READ_TIMEOUT_S, connect=CONNECT_TIMEOUT_S)
        self._http = httpx.Client(headers=headers, timeout=timeout, transport=transport, mounts=direct)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._http.close()

    @abstractmethod
    def _map(self, document: JsonObject) -> MapT:
        """Return what methods return for a map."""

    @abstractmethod
    def _answer(self, document: JsonObject) -> AnswerT:
        """Return what methods return for an answer."""

    def is_live(self) -> bool:
        """Return whether the service's process answers; never raises."""
        try:
            return self._http.get(f"{self.url}/health/live", timeout=CONNECT_TIMEOUT_S).status_code == 200
        except httpx.HTTPError:
            return False

    def readiness(self) -> tuple[bool, JsonObject]:
        """Return whether the service is ready, and the body that says what is missing."""
        reply = self._send("GET", "/health/ready")
        if reply.status_code not in (200, 503):
            raise_problem(reply)
        return reply.status_code == 200, json_object(reply)

    def register_map(
        self, scan: Path | str, options: Mapping[str, Any] | None = None, progress: UploadProgress | None = None
    ) -> MapT:
        """Upload a scan and return the new map, which answers queries once its status is `ready`."""
        fields = {"options": _json(options)} if options else {}
        return self._map(self._upload("/maps", [("file", Path(scan), progress)], fields, UPLOAD_READ_TIMEOUT_S))

    def get_map(self, map_id: str) -> MapT:
        """Return one map with its status, stage and progress."""
        return self._map(self._map_document(map_id))

    def list_maps(self, tag: str | None = None) -> Iterator[MapT]:
        """Yield all maps, page by page; with `tag`, those that have it."""
        query: JsonObject = {"tag": tag} if tag else {}
        while True:
            page = json_object(self._checked("GET", "/maps", params=query))
            yield from map(self._map, page.get("items", []))
            if not page.get("next_cursor"):
                return
            query = {**query, "cursor": page["next_cursor"]}

    def change_map(self, map_id: str, changes: Mapping[str, Any]) -> MapT:
        """Change fields of a map (`name`, `tags`, `shared_with`, …) and return it."""
        return self._map(json_object(self._checked("PATCH", _map_path(map_id), json=dict(changes))))

    def make_link(self, map_id: str, service_url: str | None = None) -> JsonObject:
        """Make a link with which phones open a map; see `POST /maps/{id}/links`. service_url: how they reach the service, None: as this
        client does."""
        address = {"service_url": service_url or self.url}
        return json_object(self._checked("POST", f"{_map_path(map_id)}/links", json=address))

    def control_points(self, map_id: str, body: Mapping[str, Any] | None = None) -> JsonObject:
        """Return the control points of a map with their residuals. body: of `PUT /maps/{id}/control-points`, None to change none."""
        path = f"{_map_path(map_id)}/control-points"
        reply = self._checked("GET", path) if body is None else self._checked("PUT", path, json=dict(body))
        return json_object(reply)

    def delete_map(self, map_id: str) -> None:
        """Delete a map with its scan and its index."""
        self._checked("DELETE", _map_path(map_id))

    def wait_for_map(
        self, map_id: str, on_update: Callable[[MapT], None] | None = None, timeout_s: float = 3600.0
    ) -> MapT:
        """Poll until the map is ready and return it.

        Raises MapFailedError when it fails and WaitTimeoutError after `timeout_s`. Waits through 503.
        """
        give_up, pause = time.monotonic() + timeout_s, POLL_FIRST_S
        while True:
            try:
                place = self._map_document(map_id)
            except ApiProblemError as problem:
                if problem.status != 503 or time.monotonic() > give_up:
                    raise
                time.sleep(min(problem.retry_after_s or POLL_LONGEST_S, 10.0))
                continue
            if on_update is not None:
                on_update(self._map(place))
            if place["status"] == "ready":
                return self._map(place)
            if place["status"] == "failed":
                raise MapFailedError(map_id, place["error"]["detail"], place.get("serving_revision"))
            if time.monotonic() > give_up:
                raise WaitTimeoutError(
                    f"Map {map_id} was still {place['status']} after {timeout_s:g} s; ask again later."
                )
            time.sleep(pause)
            pause = min(pause * 1.5, POLL_LONGEST_S)

    def localize(
        self,
        images: Path | str | Sequence[Path | str],
        map_ids: Sequence[str] = (),
        tag: str | None = None,
        mask: Path | str | Sequence[Path | str] | None = None,
        options: Mapping[str, Any] | None = None,
        progress: UploadProgress | None = None,
    ) -> AnswerT:
        """Send one query and return the answer; `status` says whether a pose was found.

        images: a panorama, a photo, or the images of a session with their poses in `options["cameras"]`. mask: one for
        all, or one per image. Either `map_ids` or `tag` names the maps. options: as for `POST /localize`; without
        `timeout_s` the service chooses its timeout, and the client waits without a limit. progress: of each image in
        turn.
        """
        if not (paths := _paths_of(images)):
            raise ClientError("images: expected an image, got none; name its file, or those of a session.")
        deadline_s = (options or {}).get("timeout_s")
        files = [("image", path, progress) for path in paths]
        files += [("mask", path, None) for path in _paths_of(mask)]
        wait_s = None if deadline_s is None else float(deadline_s) + DEADLINE_MARGIN_S
        return self._answer(self._upload("/localize", files, _fields(map_ids, tag, options), wait_s))

    def make_batch(
        self,
        images: Sequence[tuple[str, Path]],
        map_ids: Sequence[str] = (),
        tag: str | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> JsonObject:
        """Send images, each under a name, as a batch that the service keeps, and return it. options: as for `POST /batches`."""
        files: list[tuple[str, Path, UploadProgress | None]] = [("image", path, None) for _, path in images]
        names = [name for name, _ in images]
        return self._upload("/batches", files, _fields(map_ids, tag, options), UPLOAD_READ_TIMEOUT_S, names)

    def fetch(self, path: str, wait_s: float = READ_TIMEOUT_S) -> bytes:
        """Return the body at a path of the service, such as the link of a score map."""
        return self._checked("GET", path, timeout=wait_s).content

    def fetch_json(self, path: str, wait_s: float = READ_TIMEOUT_S) -> JsonObject:
        """Return the document at a path of the service."""
        return json_object(self._checked("GET", path, timeout=wait_s))

    def download(self, path: str, query: Mapping[str, str], file: BinaryIO | Path | str) -> None:
        """Write the body at a path into an open file, or into the file of a name once the service has found it, block by block."""
        try:
            with self._http.stream("GET", self.link(path), params=query, timeout=UPLOAD_READ_TIMEOUT_S) as reply:
                if not reply.is_success:
                    reply.read()
                    raise_problem(reply)
                with open(file, "wb") if isinstance(file, Path | str) else nullcontext(file) as opened:
                    for block in reply.iter_bytes():
                        opened.write(block)
        except httpx.HTTPError as error:
            raise UnreachableError(self.url, reason(error)) from error

    def link(self, path: str) -> str:
        """Return the full URL of a path from the service."""
        return path if "://" in path else f"{self.url}{path}"

    def _map_document(self, map_id: str) -> JsonObject:
        return json_object(self._checked("GET", _map_path(map_id)))

    def _upload(
        self,
        path: str,
        files: Sequence[tuple[str, Path, UploadProgress | None]],
        fields: Mapping[str, Any],
        wait_s: float | None,
        names: Sequence[str] | None = None,
    ) -> JsonObject:
        """Post files as parts of a form. wait_s: for the answer; None: without a limit. names: default: those of the files."""
        with ExitStack() as stack:
            parts = []
            for (part, file, progress), given in zip(files, names or [path.name for _, path, _ in files], strict=True):
                # Bytes of a name that are not UTF-8 become question marks.
                name = given.encode("utf-8", "replace").decode()
                opened = stack.enter_context(ProgressFile(file, progress))
                parts.append((part, (name, opened, *(["application/octet-stream"] if part == "file" else []))))
            timeout = httpx.Timeout(wait_s, connect=CONNECT_TIMEOUT_S)
            return json_object(self._checked("POST", path, data=fields, files=parts, timeout=timeout))

    def _checked(self, method: str, path: str, **request: Any) -> httpx.Response:
        """Send a request and return its reply. Raises ApiProblemError unless it succeeded."""
        reply = self._send(method, path, **request)
        if not reply.is_success:
            raise_problem(reply)
        return reply

    def _send(self, method: str, path: str, **request: Any) -> httpx.Response:
        try:
            return self._http.request(method, self.link(path), **request)
        except (httpx.ConnectError, httpx.ConnectTimeout) as error:
            if "CERTIFICATE_VERIFY_FAILED" in str(error):
                raise UntrustedError(self.url) from error
            # Words of OpenSSL, which differ by version, for an answer that is not TLS.
            if any(words in str(error) for words in ("WRONG_VERSION_NUMBER", "record layer failure")):
                raise UnreachableError(self.url, "it speaks http there, not https; use http://") from error
            raise UnreachableError(self.url, reason(error)) from error
        except httpx.TimeoutException as error:
            raise WaitTimeoutError(
                f"{self.url} accepted the connection but did not answer {method} {path} in time; see the service's "
                "log, or try again."
            ) from error
        except httpx.HTTPError as error:
            raise UnreachableError(self.url, f"the connection broke: {reason(error)}") from error


class JsonClient(BaseClient[JsonObject, JsonObject]):
    """Returns documents as the service sends them, for programs that show or store them."""

    def _map(self, document: JsonObject) -> JsonObject:
        return document

    def _answer(self, document: JsonObject) -> JsonObject:
        return document


def _fields(map_ids: Sequence[str], tag: str | None, options: Mapping[str, Any] | None) -> JsonObject:
    fields: JsonObject = {"map_id": [map_ids] if isinstance(map_ids, str) else list(map_ids)} if map_ids else {}
    fields |= {"tag": tag} if tag else {}
    return fields | ({"options": _json(options)} if options else {})


def _json(options: Mapping[str, Any]) -> str:
    """Return options as JSON. Parts of an answer, such as its pose as a prior, may be models of the typed client."""

    def of_model(value: Any) -> Any:
        if hasattr(value, "model_dump"):
            return value.model_dump(mode="json")
        raise TypeError(f"options: expected JSON and parts of answers, got a {type(value).__name__}")

    return json.dumps(options, default=of_model)


def _paths_of(given: Path | str | Sequence[Path | str] | None) -> list[Path]:
    return [Path(given)] if isinstance(given, Path | str) else [Path(each) for each in given or []]


def _map_path(map_id: str) -> str:
    return f"/maps/{quote(map_id, safe='')}"


def _check_url(url: str) -> None:
    try:
        parts = urlsplit(url)
        is_address = parts.scheme in ("http", "https") and bool(parts.hostname) and parts.port != 0
    except ValueError:
        is_address = False
    if not is_address:
        raise InvalidUrlError(f"Expected a URL such as http://127.0.0.1:8000, got {url!r}; set --url or PANOLOC_URL.")


def _check_key(key: str | None) -> None:
    if key and not _KEY.fullmatch(key):
        raise InvalidKeyError(
            "Expected a key of ASCII letters, digits and punctuation, got a key with spaces, line ends or other "
            "characters, perhaps at its end; correct PANOLOC_API_KEY."
        )
