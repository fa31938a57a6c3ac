"""HEIC and AVIF files as JPEG, so that everything behind sees what it sees of other photos, and small copies of any image for lists.

Their decoders are native code, and three changed bytes have crashed one. So a process of its own decodes each file, within limits:
`python -m panoloc.core.image.conversion`. What it writes is read like any upload. The JPEG is upright and keeps EXIF, XMP and colour
profile, which small copies do not. An image with an alpha channel becomes a PNG.
"""

import io
import signal
import subprocess
import sys
from typing import TYPE_CHECKING

from panoloc.core.image.image_header import CONVERTED_KINDS, IMAGE, Upload, image_kind, open_image
from panoloc.core.sandbox import SandboxLimits, refuse_system_calls, sandbox_environment, take_limits

if TYPE_CHECKING:
    from PIL import Image

_LIMITS = SandboxLimits(memory_bytes=4 << 30, cpu_s=60)  # 100 megapixels take 1.4 GB and 4 s
_QUALITY, _SMALL_QUALITY = 95, 82
_EXIF_IFD, _MAKER_NOTE = 0x8769, 0x927C
_MOST_XMP_BYTES = 65_000  # of a segment of a JPEG
_TOO_LARGE, _DAMAGED = 3, 4


def converted(data: bytes, upload: Upload, max_pixels: int, max_side: int | None = None) -> bytes:
    """Return a HEIC or AVIF file as a JPEG or PNG; with `max_side`, in pixels, any image as an upright JPEG no larger than that.

    Raises the upload's `damaged_error` or `too_large_error`; of a small copy as `open_image` does, too.
    """
    if max_side is not None:
        open_image(data, upload, max_pixels)
    sizes = [str(size) for size in (max_pixels, max_side) if size is not None]
    try:
        done = subprocess.run(
            [sys.executable, "-P", "-m", "panoloc.core.image.conversion", *sizes],
            input=data,
            capture_output=True,
            env=sandbox_environment(),
            timeout=2 * _LIMITS.cpu_s,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise upload.too_large_error(
            f"{upload.name}: expected an image that is decoded within {2 * _LIMITS.cpu_s} s, got none; scale it down"
        ) from error
    if done.returncode == 0:
        return done.stdout
    reason = (done.stderr.decode(errors="replace").strip().splitlines() or ["no message"])[-1][:200]
    if done.returncode == _TOO_LARGE:
        raise upload.too_large_error(
            f"{upload.name}: expected at most {max_pixels:,} pixels, got {reason}; scale it down"
        )
    if done.returncode < 0:
        reason = f"its decoder ended with {signal.Signals(-done.returncode).name}"
    raise upload.damaged_error(
        f"{upload.name}: the file ends early or is damaged ({reason}); upload it again in full, or as JPEG"
    )


def _convert(data: bytes, max_pixels: int) -> bytes:
    from pi_heif import HeifImageFile
    from PIL import ImageOps
    from PIL.AvifImagePlugin import AvifImageFile

    # Not `Image.open`, which says nothing of what is wrong with a file.
    with (HeifImageFile if image_kind(data) == "heic" else AvifImageFile)(io.BytesIO(data)) as opened:
        if opened.width * opened.height > max_pixels:
            raise MemoryError(f"{opened.width:,} x {opened.height:,}")
        upright = ImageOps.exif_transpose(opened)
    out = io.BytesIO()
    kept = {"exif": _exif(upright), "icc_profile": upright.info.get("icc_profile")}
    if upright.mode in ("RGBA", "RGBa", "LA", "La"):
        upright.convert("RGBA").save(out, "PNG", compress_level=1, **kept)
    else:
        xmp = upright.info.get("xmp") or b""
        kept |= {"xmp": xmp} if 0 < len(xmp) < _MOST_XMP_BYTES else {}
        upright.convert("RGB").save(out, "JPEG", quality=_QUALITY, subsampling=0, **kept)
    return out.getvalue()


def _small(data: bytes, max_pixels: int, max_side: int) -> bytes:
    """Return a small copy; of a JPEG only as much as that needs is decoded."""
    from PIL import ImageOps

    if image_kind(data) in CONVERTED_KINDS:
        data = _convert(data, max_pixels)
    with open_image(data, IMAGE, max_pixels) as opened:
        opened.draft("RGB", (max_side, max_side))
        upright = ImageOps.exif_transpose(opened)
    upright.thumbnail((max_side, max_side))
    out = io.BytesIO()
    upright.convert("RGB").save(out, "JPEG", quality=_SMALL_QUALITY)
    return out.getvalue()


def _exif(image: "Image.Image") -> bytes:
    """Return the EXIF data without the maker's own, which can be too large for a JPEG; none where they are damaged."""
    try:
        exif = image.getexif()
        exif.get_ifd(_EXIF_IFD).pop(_MAKER_NOTE, None)
        return exif.tobytes()
    except Exception:
        return b""


def main() -> int:
    """Convert standard input to standard output and return the exit code."""
    data = sys.stdin.buffer.read()
    take_limits(_LIMITS)
    refuse_system_calls()
    try:
        max_pixels, *max_side = map(int, sys.argv[1:])
        sys.stdout.buffer.write(_small(data, max_pixels, *max_side) if max_side else _convert(data, max_pixels))
    except MemoryError as error:
        print(error or "more than its decoder may take", file=sys.stderr)
        return _TOO_LARGE
    except Exception as error:
        print(str(error) or type(error).__name__, file=sys.stderr)
        return _DAMAGED
    return 0


if __name__ == "__main__":
    sys.exit(main())
