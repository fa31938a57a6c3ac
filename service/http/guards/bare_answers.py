"""Answers that are written straight to a connection, where no ASGI application is asked."""

import json

from service.jobs import new_id
from service.problems import HTTP_PROBLEMS, MEDIA_TYPE, document_with

_RETRY_AFTER_S = 5
_REASONS = {
    400: "Bad Request",
    408: "Request Timeout",
    431: "Request Header Fields Too Large",
    503: "Service Unavailable",
}


def bare_refusal(status: int, detail: str) -> bytes:
    """Return a whole response that says what is wrong and ends its connection. status: 400, 408, 431 or 503."""
    body = json.dumps(document_with(HTTP_PROBLEMS[status], detail, new_id("req"))).encode()
    head = [
        f"HTTP/1.1 {status} {_REASONS[status]}",
        f"Content-Type: {MEDIA_TYPE}",
        f"Content-Length: {len(body)}",
        "Connection: close",
    ]
    if status == 503:
        head.append(f"Retry-After: {_RETRY_AFTER_S}")
    return ("\r\n".join(head) + "\r\n\r\n").encode() + body
