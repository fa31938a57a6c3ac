"""What `panoloc place` has placed, as batches of the service, which the console shows."""

from panoloc.service.cli.placing.place_folder import PlaceFolder
from panoloc.service.client import JsonClient, JsonObject

# Files that are open at the same time.
_AT_A_TIME = 200


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
