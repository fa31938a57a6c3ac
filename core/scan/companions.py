"""Files beside a scan that it refers to: materials, textures, buffers."""

from pathlib import Path, PurePosixPath

from panoloc.core.errors import ScanContentError, ScanDamagedError
from panoloc.core.scan.reading_context import ReadingContext


def companion(context: ReadingContext, name: str, what: str) -> Path:
    """Return the file that the scan calls `name`, relative to itself. what: for the message, such as "texture".

    Raises ScanDamagedError for a name that leads out of the archive, ScanContentError where there is no such file.
    """
    relative = PurePosixPath(name.strip().replace("\\", "/"))
    if context.folder is None:
        raise ScanContentError(
            f"The scan refers to the {what} {name[:100]!r}, which was not uploaded with it. Put the scan and all "
            "files that it refers to into one zip and upload the zip."
        )
    root = context.folder.resolve()
    if "\x00" in name:
        raise _leads_out(name, what)
    found = (context.path.parent / relative).resolve()
    if relative.is_absolute() or not found.is_relative_to(root):
        # Programs write the paths of the machine that they ran on; the file itself often lies beside the scan.
        found = (context.path.parent / relative.name).resolve()
    if not found.is_relative_to(root):
        raise _leads_out(name, what)
    if not found.is_file():
        same = [path for path in found.parent.glob("*") if path.name.lower() == found.name.lower() and path.is_file()]
        if len(same) != 1:
            raise ScanContentError(
                f"The scan refers to the {what} {name[:100]!r}, but the zip holds no such file. Add it and upload it again."
            )
        found = same[0]
    return found


def _leads_out(name: str, what: str) -> ScanDamagedError:
    return ScanDamagedError(
        f"The scan refers to the {what} {name[:100]!r}, which is outside the upload. Refer only to files beside the "
        "scan."
    )
