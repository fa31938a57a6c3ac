"""Saves answers and their pictures in a folder."""

import json
from collections.abc import Sequence
from pathlib import Path

from panoloc.service.client import JsonObject, PanolocClient


class AnswerFolder:
    """A folder with one JSON file and up to three PNG files per query, named after it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._taken: set[str] = set()

    def save(self, query: Path, images: Sequence[Path], answer: JsonObject, client: PanolocClient) -> list[Path]:
        """Write the answer and fetch its pictures; return the files written. Creates the folder.

        query: gives the files their name. images: what was sent; the answer lists them as `files`, for exports.
        """
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            reason = error.strerror or str(error)
            raise OSError(f"--out {self.folder}: the folder cannot be made ({reason}); choose another one") from error
        stem = self._free_stem(query.stem)
        written = [self.folder / f"{stem}.json"]
        document = {"files": [str(image.resolve()) for image in images], **answer}
        text = json.dumps(document, indent=2, ensure_ascii=False) + "\n"
        written[0].write_bytes(text.encode(errors="backslashreplace"))  # file names that are not UTF-8
        for kind, path in (answer.get("artifacts") or {}).items():
            if path:
                written.append(self.folder / f"{stem}.{kind.replace('_', '-')}.png")
                written[-1].write_bytes(client.fetch(path))
        return written

    def _free_stem(self, stem: str) -> str:
        """Return a name that no other query of this run has: two folders may hold the same file name."""
        name, number = stem, 2
        while name in self._taken:
            name, number = f"{stem}-{number}", number + 1
        self._taken.add(name)
        return name
