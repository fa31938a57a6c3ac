"""`python -m panoloc.core.scan.e57 SCAN.e57 FOLDER`: write the images of a file into a folder, and print how many there
are.

`cameras.json` holds the intrinsics of pinhole images, such as cube faces, in the form that queries take. An image that
is already there with the same bytes keeps its time. Damage is reported in one line on standard error, with exit code 3.
"""

import json
import re
import sys
from pathlib import Path, PurePosixPath

from panoloc.core.errors import CoreError
from panoloc.core.options import CAMERAS_FILE, ScanOptions
from panoloc.core.scan.e57.images import E57Image, images_of
from panoloc.core.scan.e57.reader import opened
from panoloc.core.scan.file_names import distinct_names
from panoloc.core.scan.reading_context import ReadingContext

REFUSED = 3


def main(arguments: list[str]) -> int:
    """Extract the images and return the exit code."""
    scan, folder = Path(arguments[0]), Path(arguments[1])
    try:
        context = ReadingContext(scan, ScanOptions(), scan.stat().st_size)
        with opened(context) as image_file:
            images, num_others = images_of(image_file.root())
            folder.mkdir(parents=True, exist_ok=True)
            names = _names(images)
            for image, name in zip(images, names, strict=True):
                target, data = folder / name, image.read()
                if not target.exists() or target.read_bytes() != data:
                    target.write_bytes(data)
            pinholes = [(name, image.pinhole) for name, image in zip(names, images, strict=True)]
            cameras = {name: pinhole.as_camera() for name, pinhole in pinholes if pinhole is not None}
            if cameras:
                (folder / CAMERAS_FILE).write_text(json.dumps(cameras), encoding="utf-8")
    except (CoreError, OSError) as error:
        print(error, file=sys.stderr)
        return REFUSED
    print(json.dumps({"num_images": len(images), "num_others": num_others}))
    return 0


def _names(images: list[E57Image]) -> list[str]:
    """Return file names of the images: without folders and control characters, with the suffix of their real format."""
    plain = [re.sub(r"[^\w.+ -]", "_", PurePosixPath(image.name).name).strip(". ") or "image" for image in images]
    stems = [re.sub(r"(?i)\.(jpe?g|png)$", "", name)[-150:] for name in plain]
    return distinct_names(f"{stem or 'image'}{image.suffix}" for stem, image in zip(stems, images, strict=True))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
