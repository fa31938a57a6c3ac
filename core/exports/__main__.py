"""`python -m panoloc.core.exports TOUR.json FORMAT TARGET`: write an export into a folder, or into a `.zip`.

A refusal is reported on standard error in one line, with exit code 3.
"""

import shutil
import sys
import tempfile
import zipfile
from collections.abc import Iterable
from pathlib import Path

from panoloc.core.errors import CoreError
from panoloc.core.exports.formats import EXPORTERS, export
from panoloc.core.exports.tour import ExportedFile, read_tour

REFUSED = 3
_EARLIEST = (1980, 1, 1, 0, 0, 0)  # of zip files: the same photos make the same bytes


def main(arguments: list[str]) -> int:
    """Write one export and return the exit code."""
    tour, name, target = Path(arguments[0]), arguments[1], Path(arguments[2])
    if name not in EXPORTERS:
        print(f"expected one of {', '.join(EXPORTERS)}, got {name}", file=sys.stderr)
        return REFUSED
    if target.suffix == ".zip":
        # Beside it: the system's own folder may be memory, as in a container.
        tempfile.tempdir = str(target.parent)
    try:
        with tempfile.TemporaryDirectory(prefix="panoloc-photos-") as folder:
            files = export(name, read_tour(tour, Path(folder)))
            (write_zip if target.suffix == ".zip" else write_folder)(files, target)
    except CoreError as error:
        print(error, file=sys.stderr)
        return REFUSED
    return 0


def write_folder(files: Iterable[ExportedFile], folder: Path) -> None:
    """Write files below a folder, over those of an earlier export."""
    folder.mkdir(parents=True, exist_ok=True)
    for file in files:
        target = folder / file.path
        target.parent.mkdir(parents=True, exist_ok=True)
        if isinstance(file.content, bytes):
            target.write_bytes(file.content)
        else:
            shutil.copyfile(file.content, target)


def write_zip(files: Iterable[ExportedFile], path: Path) -> None:
    """Write files into a zip; photos and clouds as they are, text compressed."""
    with zipfile.ZipFile(path, "w", allowZip64=True) as archive:
        for file in files:
            entry = zipfile.ZipInfo(file.path, _EARLIEST)
            entry.external_attr = 0o644 << 16
            if isinstance(file.content, bytes):
                archive.writestr(entry, file.content, zipfile.ZIP_DEFLATED)
                continue
            entry.file_size = file.content.stat().st_size
            with file.content.open("rb") as source, archive.open(entry, "w") as sink:
                shutil.copyfileobj(source, sink, 2**20)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
