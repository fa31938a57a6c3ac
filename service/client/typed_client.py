"""`PanolocClient`: the client whose maps and answers are the models of the API, so that editors and mypy know their fields.

with PanolocClient("http://127.0.0.1:8000") as client:
    place = client.wait_for_map(client.register_map(Path("office.ply")).id)
    answer = client.localize(Path("photo.jpg"), map_ids=[place.id])    # or several images of one session
    if answer.status == "localized":
        print(answer.pose.map_from_camera.position_m.x)
"""

from typing import Annotated, Any, TypeVar

from pydantic import Field, TypeAdapter, ValidationError

from panoloc.service.answer import Ambiguous, Localized, NotLocalized
from panoloc.service.client.client import BaseClient
from panoloc.service.client.errors import UnexpectedReplyError
from panoloc.service.client.replies import JsonObject
from panoloc.service.http.schemas.known_map import Map

Answer = Localized | Ambiguous | NotLocalized
"""Which one it is, `status` says: where that is `localized` or `ambiguous`, there is a `pose`."""

_Model = TypeVar("_Model")
_MAP = TypeAdapter(Map)
_ANSWER: TypeAdapter[Answer] = TypeAdapter(Annotated[Answer, Field(discriminator="status")])


class PanolocClient(BaseClient[Map, Answer]):
    """Calls one running service; see `BaseClient`. Fields that a newer service adds are kept, as attributes without a type."""

    def _map(self, document: JsonObject) -> Map:
        return _read(_MAP, document)

    def _answer(self, document: JsonObject) -> Answer:
        return _read(_ANSWER, document)


def _read(model: TypeAdapter[_Model], document: Any) -> _Model:
    try:
        return model.validate_python(document)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        raise UnexpectedReplyError(
            f"Expected a reply as this version of panoloc knows it, got another at {'.'.join(map(str, first['loc'])) or 'its top'}: "
            f"{first['msg']}; install the version of the service."
        ) from error
