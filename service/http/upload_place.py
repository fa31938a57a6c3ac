"""A place for an upload: held from before its first byte until it is answered."""

from collections.abc import AsyncIterator

from fastapi import Request

from service.http.access import caller_of
from service.services import services_of


async def hold_upload_place(request: Request) -> AsyncIterator[None]:
    """Depend on this, after the scope, where scans or batches are uploaded. Raises UploadsError."""
    with services_of(request).uploads.place(caller_of(request).id):
        yield
