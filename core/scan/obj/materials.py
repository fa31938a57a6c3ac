"""MTL files: which colour and which texture a material has."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from panoloc.core.errors import ScanDamagedError

# Options of map_Kd that take more than one value: how many at most.
_NUM_VALUES = {"-mm": 2, "-o": 3, "-s": 3, "-t": 3}


@dataclass(frozen=True)
class ObjMaterial:
    """diffuse: (3,), sRGB 0..1. texture: name of its file, or None. scale, offset: (2,), of texture coordinates."""

    diffuse: NDArray[np.float64]
    texture: str | None = None
    scale: tuple[float, ...] = (1.0, 1.0)
    offset: tuple[float, ...] = (0.0, 0.0)
    clamped: bool = False


def read_materials(path: Path) -> dict[str, ObjMaterial]:
    """Return the materials of an MTL file by name. Raises ScanDamagedError."""
    found: dict[str, ObjMaterial] = {}
    name = ""
    for number, line in enumerate(path.read_text("utf-8-sig", "replace").splitlines(), start=1):
        word, _, rest = line.strip().partition(" ")
        material = found.get(name, ObjMaterial(np.ones(3)))
        try:
            if word.lower() == "newmtl":
                name = rest.strip()
                found[name] = ObjMaterial(np.ones(3))
            elif word.lower() == "kd" and material.texture is None:
                found[name] = replace(material, diffuse=np.array(rest.split()[:3], np.float64).reshape(3))
            elif word.lower() == "map_kd":
                # Many programs write black beside a texture; the texture is what they show.
                found[name] = _mapped(rest)
        except ValueError as error:
            raise ScanDamagedError(
                f"Line {number} of the material file {path.name} is not understood: {line[:80]!r}. Export the scan again."
            ) from error
    return found


def _mapped(text: str) -> ObjMaterial:
    """Parse `[-option value …] file name`; the name may hold spaces."""
    options: dict[str, list[str]] = {}
    words = text.split()
    while words and words[0].startswith("-"):
        option = words.pop(0).lower()
        values = options[option] = words[:1]
        del words[:1]
        while words and len(values) < _NUM_VALUES.get(option, 1) and _is_number(words[0]):
            values.append(words.pop(0))
    scale = (*map(float, options.get("-s", ())), 1.0, 1.0)[:2]
    offset = (*map(float, options.get("-o", ())), 0.0, 0.0)[:2]
    name = text[text.index(words[0]) :].strip() if words else None
    return ObjMaterial(np.ones(3), name, scale, offset, options.get("-clamp") == ["on"])


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
