"""What `panoloc place` has placed, as batches of the service: the console shows them, and people place photos by hand there."""

from collections.abc import Iterator, Sequence
from urllib.parse import urlencode

from panoloc.service.batches.tour import Photo
from panoloc.service.cli.placing.place_folder import PlaceFolder
from panoloc.service.client import ApiProblemError, JsonClient, JsonObject

# Files that are open at the same time, and images on a page.
_AT_A_TIME = 200
_NOT_FOUND = 404


def keep(client: JsonClient, folder: PlaceFolder, name: str) -> list[JsonObject]:
    """Send the photos with an answer that no batch has yet, with their answers, and return the batches. Raises ClientError.

    A batch that already has them so, as a run into another folder leaves it, is taken in place of another one. name: of the batch; several
    are numbered.
    """
    unkept = folder.unkept()
    parts = [unkept[first : first + _AT_A_TIME] for first in range(0, len(unkept), _AT_A_TIME)]
    made = []
    for number, photos in enumerate(parts, 1):
        numbered = name if len(parts) == 1 else f"{name} ({number})"
        batch = _same(client, folder, numbered, photos)
        if batch is None:
            answers = [photo.result["answer"]["id"] for photo in photos if photo.result is not None]
            images = [(photo.name, photo.image) for photo in photos if photo.image is not None]
            options = {"name": numbered, "answers": answers}
            batch = client.make_batch(images, folder.question.map_ids, folder.question.tag, options)
        folder.note_batch(photos, str(batch["id"]))
        made.append(batch)
    return made


def take_hand_placements(client: JsonClient, folder: PlaceFolder) -> None:
    """Store the answers of photos that a person has placed since, or no longer places, in place of theirs. Raises ClientError."""
    for batch_id, photos in folder.kept().items():
        for item in _items(client, f"/batches/{batch_id}"):
            photo, answer = photos.get(item["name"]), item["answer"]
            if photo is None or photo.result is None or answer is None:
                continue
            former = photo.result["answer"]
            if answer != former and "hand" in (answer["placed_by"], former.get("placed_by")):
                folder.put_result(photo, {"status": item["status"], "answer": answer})


def _same(client: JsonClient, folder: PlaceFolder, name: str, photos: Sequence[Photo]) -> JsonObject | None:
    """Return the batch of a name that has the same photos with the same answers, None without one."""
    wanted = (name, folder.question.map_ids, folder.question.tag, len(photos))
    for batch in _items(client, "/batches"):
        if (batch["name"], batch["map_ids"], batch["tag"], batch["num_images"]) == wanted:
            path = f"/batches/{batch['id']}"
            kept = {item["name"]: item for item in _items(client, path)}
            if all(_is_kept(client, path, kept.get(photo.name), photo) for photo in photos):
                return batch
    return None


def _is_kept(client: JsonClient, batch: str, item: JsonObject | None, photo: Photo) -> bool:
    """Tell whether an image of the batch at this path is the photo, at the same place and seen by the same camera."""
    if item is None or item["answer"] is None or photo.result is None or photo.image is None:
        return False
    was, now = (
        (answer["status"], answer["map_id"], answer["pose"], answer["images"][0]["camera"])
        for answer in (item["answer"], photo.result["answer"])
    )
    return was == now and client.fetch(f"{batch}/images/{item['number']}") == photo.image.read_bytes()


def _items(client: JsonClient, path: str) -> Iterator[JsonObject]:
    """Yield all batches, or the images of one; none of one that was deleted."""
    cursor: str | None = ""
    while cursor is not None:
        query = urlencode({"limit": _AT_A_TIME} | ({"cursor": cursor} if cursor else {}))
        try:
            page = client.fetch_json(f"{path}?{query}")
        except ApiProblemError as problem:
            if problem.status == _NOT_FOUND:
                return
            raise
        yield from page["items"]
        cursor = page["next_cursor"]
