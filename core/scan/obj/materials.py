"""MTL files: which colour and which texture a material has."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from core.errors import ScanDamagedError

_MAX_BYTES = 1 << 24
# Options of map_Kd with how many values they take.
_OPTIONS = {
    "-blendu": 1, "-blendv": 1, "-boost": 1, "-mm": 2, "-o": 3, "-s": 3, "-t": 3, "-texres": 1, "-clamp": 1, "-bm": 1,
    "-imfchan": 1, "-type": 1, "-cc": 1, "-colorspace": 1,
}  # fmt: skip


@dataclass(frozen=True)
class ObjMaterial:
    """diffuse: (3,), sRGB 0..1. texture: the name of its file, None without. scale, offset: (2,), of texture coordinates."""

    diffuse: NDArray[np.float64]
    texture: str | None = None
    scale: tuple[float, float] = (1.0, 1.0)
    offset: tuple[float, float] = (0.0, 0.0)
    clamped: bool = False


def read_materials(path: Path) -> dict[str, ObjMaterial]:
    """Return the materials of an MTL file by name. Raises ScanDamagedError."""
    if path.stat().st_size > _MAX_BYTES:
        raise ScanDamagedError(
            f"The material file {path.name} has more than {_MAX_BYTES:,} bytes. Export the scan again."
        )
    found: dict[str, ObjMaterial] = {}
    name, diffuse, mapped = "", np.ones(3), ObjMaterial(np.ones(3))
    for number, line in enumerate(path.read_text("utf-8-sig", "replace").splitlines(), start=1):
        word, _, rest = line.strip().partition(" ")
        word = word.lower()
        try:
            if word == "newmtl":
                name, diffuse, mapped = rest.strip(), np.ones(3), ObjMaterial(np.ones(3))
            elif word == "kd":
                diffuse = np.array(rest.split()[:3], np.float64).reshape(3)
            elif word == "map_kd":
                mapped = _mapped(rest)
            else:
                continue
        except ValueError as error:
            raise ScanDamagedError(
                f"Line {number} of the material file {path.name} is not understood: {line[:80]!r}. Export the scan again."
            ) from error
        # Many programs write black beside a texture; the texture is what they show.
        shown = np.ones(3) if mapped.texture is not None else diffuse
        found[name] = ObjMaterial(shown, mapped.texture, mapped.scale, mapped.offset, mapped.clamped)
    return found


def _mapped(text: str) -> ObjMaterial:
    """Parse `[-option value …] file name`; the name may hold spaces."""
    scale, offset, clamped = (1.0, 1.0), (0.0, 0.0), False
    words = text.split()
    while words and words[0].lower() in _OPTIONS:
        option, most = words.pop(0).lower(), 0
        values: list[str] = []
        while words and len(values) < _OPTIONS[option] and (most < 1 or _is_number(words[0])):
            values.append(words.pop(0))
            most += 1
        pair = tuple(float(value) for value in (*values, "0", "0")[:2]) if option in ("-s", "-o") else (1.0, 1.0)
        if option == "-s":
            scale = (pair[0], pair[1] if len(values) > 1 else 1.0)
        elif option == "-o":
            offset = (pair[0], pair[1])
        elif option == "-clamp":
            clamped = values == ["on"]
    return ObjMaterial(np.ones(3), text[text.index(words[0]) :].strip() if words else None, scale, offset, clamped)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
