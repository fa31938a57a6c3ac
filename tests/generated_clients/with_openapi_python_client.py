"""Localizes with a client that openapi-python-client has generated; checked by mypy beside it, and run as a program."""

import json
import sys
from io import BytesIO
from pathlib import Path

import httpx
from panoloc_client import AuthenticatedClient
from panoloc_client.api.localization import localize
from panoloc_client.models import LocalizeBody, Localized, LocalizeOptions
from panoloc_client.types import File


def main(url: str, map_id: str, path: str) -> None:
    """Print the matrix of the pose."""
    image = File(payload=BytesIO(Path(path).read_bytes()), file_name="panorama.jpg", mime_type="image/jpeg")
    body = LocalizeBody(image=[image], map_id=[map_id], options=LocalizeOptions(top_k=2, timeout_s=500.0))
    with AuthenticatedClient(url, token="any, where no keys are set", timeout=httpx.Timeout(500)) as client:
        found = localize.sync(client=client, body=body)
    assert isinstance(found, Localized), found
    print(json.dumps(found.pose.map_from_camera.matrix))


main(*sys.argv[1:])
