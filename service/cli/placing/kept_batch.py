"""What `panoloc place` has placed, as batches of the service: the console shows them, and people place photos by hand there."""

from collections.abc import Iterator
from urllib.parse import urlencode

from panoloc.service.cli.placing.place_folder import PlaceFolder
from panoloc.service.client import ApiProblemError, JsonClient, JsonObject

# Files that are open at the same time, and images on a page.
_AT_A_TIME = 200
_NOT_FOUND = 404


def keep(client: JsonClient, folder: PlaceFolder, name: str) -> list[JsonObject]:
    """Send the photos with an answer that no batch has yet, with their answers, and return the batches. Raises ClientError.

    name: of the batch; several are numbered.
    """
    unkept = folder.unkept()
    parts = [unkept[first : first + _AT_A_TIME] for first in range(0, len(unkept), _AT_A_TIME)]
    made = []
    for number, photos in enumerate(parts, 1):
        answers = [photo.result["answer"]["id"] for photo in photos if photo.result is not None]
        options = {"name": name if len(parts) == 1 else f"{name} ({number})", "answers": answers}
        images = [(photo.name, photo.image) for photo in photos if photo.image is not None]
        batch = client.make_batch(images, folder.question.map_ids, folder.question.tag, options)
        folder.note_batch(photos, str(batch["id"]))
        made.append(batch)
    return made


def take_hand_placements(client: JsonClient, folder: PlaceFolder) -> None:
    """Store the answers of photos that a person has placed since, or no longer places, in place of theirs. Raises ClientError."""
    for batch_id, photos in folder.kept().items():
        for item in _items(client, batch_id):
            photo, answer = photos.get(item["name"]), item["answer"]
            if photo is None or photo.result is None or answer is None:
                continue
            former = photo.result["answer"]
            if answer != former and "hand" in (answer["placed_by"], former.get("placed_by")):
                folder.put_result(photo, {"status": item["status"], "answer": answer})


def _items(client: JsonClient, batch_id: str) -> Iterator[JsonObject]:
    """Yield the images of a batch; none of one that was deleted."""
    cursor: str | None = ""
    while cursor is not None:
        query = urlencode({"limit": _AT_A_TIME} | ({"cursor": cursor} if cursor else {}))
        try:
            page = client.fetch_json(f"/batches/{batch_id}?{query}")
        except ApiProblemError as problem:
            if problem.status == _NOT_FOUND:
                return
            raise
        yield from page["items"]
        cursor = page["next_cursor"]
