"""Keeps answers and their pictures in a folder."""

import json
from collections.abc import Sequence
from pathlib import Path

from service.client import JsonObject, PanolocClient


class AnswerFolder:
    """A folder with one JSON file and up to three PNG files per panorama, named after it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._taken: set[str] = set()

    def save(self, query: Path, images: Sequence[Path], answer: JsonObject, client: PanolocClient) -> list[Path]:
        """Write the answer and fetch its pictures; return the files written. Creates the folder.

        query: what the answer is named after. images: what was sent, which the answer names as `files`, for exports.
        """
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            reason = error.strerror or str(error)
            raise OSError(f"--out {self.folder}: the folder cannot be made ({reason}); choose another one") from error
        stem = self._free_stem(query.stem)
        answer_file = self.folder / f"{stem}.json"
        document = {"files": [str(image.resolve()) for image in images], **answer}
        text = json.dumps(document, indent=2, ensure_ascii=False) + "\n"
        answer_file.write_bytes(text.encode(errors="backslashreplace"))  # names that are no UTF-8
        written = [answer_file]
        for kind, path in (answer.get("artifacts") or {}).items():
            if path:
                picture = self.folder / f"{stem}.{kind.replace('_', '-')}.png"
                picture.write_bytes(client.fetch(path))
                written.append(picture)
        return written

    def _free_stem(self, stem: str) -> str:
        """Return a name that no other panorama of this run has taken, as two folders may hold the same file name."""
        name, number = stem, 2
        while name in self._taken:
            name, number = f"{stem}-{number}", number + 1
        self._taken.add(name)
        return name
