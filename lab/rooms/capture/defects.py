"""What is in panoramas but not of the place: void, bars, patches and fills around the poles, drawn over a panorama with the truth kept."""

import io
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFilter

from panoloc.core.camera.rig import Panorama
from panoloc.lab.rooms.capture.camera_look import encode_jpeg
from panoloc.lab.rooms.capture.views import pixel_centers, viewing_directions

Pixels = NDArray[np.uint8]
Mask = NDArray[np.bool_]
_BLACK, _WHITE = np.zeros(3, np.uint8), np.full(3, 255, np.uint8)
Draw = Callable[[Pixels, np.random.Generator], tuple[Pixels, Mask]]


def add_defect(panorama: Panorama, kind: str, rng: np.random.Generator) -> tuple[Panorama, Mask]:
    """Return the panorama with a defect of DEFECTS drawn over it, its mask untouched, and what the defect covers (H, W).

    Compression comes after, as it does in a camera: `apply_look` with a JPEG quality.
    """
    color, covered = DEFECTS[kind](panorama.color.copy(), rng)
    return Panorama(color, panorama.valid), covered


def with_any_defect(panorama: Panorama, rng: np.random.Generator) -> tuple[Panorama, Mask]:
    """Draw one defect of all kinds over a panorama and compress it as a JPEG; return it, its mask untouched, and what is covered (H, W)."""
    drawn, covered = add_defect(panorama, list(DEFECTS)[int(rng.integers(len(DEFECTS)))], rng)
    stored = encode_jpeg(drawn.color, int(rng.integers(75, 96)))
    return Panorama(np.asarray(Image.open(io.BytesIO(stored))), panorama.valid), covered


def _void(fill: Pixels | None, share: tuple[float, float], waves: float) -> Draw:
    """Cover hills of a random function with a colour, None: any."""

    def draw(color: Pixels, rng: np.random.Generator) -> tuple[Pixels, Mask]:
        field = _field(len(color), waves, rng)
        if rng.random() < 0.6:  # ceilings and floors are missed more often than walls
            up = _elevation(len(color)) * rng.choice([-1, 1])
            field = field + 1.5 * np.sin(up)
        hole = field > _quantile(field, 1 - rng.uniform(*share))
        return _filled(color, hole, _any(rng) if fill is None else fill, rng), hole

    return draw


def _field(height: int, waves: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return a smooth random function (H, 2H) on the sphere of about `waves` hills around a great circle, somewhat ragged."""
    directions = viewing_directions(*pixel_centers(2 * height), 2 * height)
    total = np.zeros(len(directions))
    for octave, strength in ((1.0, 1.0), (3.0, 0.3), (9.0, 0.12)):
        for _ in range(8):
            frequency = rng.normal(size=3) * waves * octave / 2
            total += strength * np.cos(directions @ frequency + rng.uniform(0, 2 * np.pi)) / 2
    return total.reshape(height, 2 * height)


def _elevation(height: int) -> NDArray[np.float64]:
    """Return elevations (H, 1) of the rows, radians."""
    return np.asarray(np.pi / 2 - np.pi * (np.arange(height) + 0.5) / height)[:, None]


def _quantile(field: NDArray[np.float64], share: float) -> float:
    """Return the value below which `share` of the sphere lies."""
    weight = np.broadcast_to(np.cos(_elevation(len(field))), field.shape).ravel()
    order = np.argsort(field, axis=None)
    below = np.cumsum(weight[order])
    return float(field.ravel()[order][np.searchsorted(below, share * below[-1])])


def _filled(color: Pixels, hole: Mask, fill: NDArray[np.uint8], rng: np.random.Generator) -> Pixels:
    """Return the image with a flat color in the hole, its rim mixed over up to a pixel as resampling does."""
    soft = Image.fromarray(hole.astype(np.uint8) * 255).filter(ImageFilter.GaussianBlur(float(rng.uniform(0, 0.8))))
    share = np.where(hole, 255, np.asarray(soft, np.float32) * (rng.random() < 0.5))[..., None] / 255
    return np.asarray(color * (1 - share) + fill * share + 0.5).astype(np.uint8)


def _any(rng: np.random.Generator) -> NDArray[np.uint8]:
    grey = rng.integers(40, 216)
    return np.full(3, grey, np.uint8) if rng.random() < 0.5 else rng.integers(0, 256, 3).astype(np.uint8)


def _one_of(rng: np.random.Generator) -> NDArray[np.uint8]:
    fill = (_BLACK, _BLACK, _WHITE, None)[int(rng.integers(4))]
    return _any(rng) if fill is None else fill


def _letter_box(color: Pixels, rng: np.random.Generator) -> tuple[Pixels, Mask]:
    height = len(color)
    top, bottom = (rng.uniform(0.08, 0.3, 2) * height).astype(int)
    row = np.arange(height)
    bar = np.broadcast_to(((row < top) | (row >= height - bottom))[:, None], color.shape[:2])
    return _filled(color, bar, _one_of(rng), rng), bar


def _columns(color: Pixels, rng: np.random.Generator) -> tuple[Pixels, Mask]:
    width = color.shape[1]
    left, right = (rng.uniform(0.05, 0.25, 2) * width).astype(int)
    column = np.arange(width)
    bar = np.broadcast_to((column < left) | (column >= width - right), color.shape[:2])
    return _filled(color, bar, _one_of(rng), rng), bar


def _wedges(color: Pixels, rng: np.random.Generator) -> tuple[Pixels, Mask]:
    """Draw the stepped rims of frames that were stitched while the hand sank and rose."""
    height, width = color.shape[:2]
    covered = np.zeros((height, width), np.bool_)
    row, column = np.arange(height)[:, None], np.arange(width)
    for edge in (row, row[::-1]):
        num_frames = int(rng.integers(5, 16))
        frame = column * num_frames // width
        slope = rng.normal(0, 0.1, num_frames)[frame] * (column - frame * width / num_frames)
        covered |= edge < (rng.uniform(0.08, 0.22) + rng.normal(0, 0.03, num_frames)[frame]) * height + slope
    return _filled(color, covered, _BLACK, rng), covered


def _cap(color: Pixels, rng: np.random.Generator) -> tuple[int, Mask]:
    """Draw how many rows a cap around the lower pole takes that reaches 12 to 35 degrees from it; return them with its pixels."""
    rows = int(rng.uniform(12, 35) / 180 * len(color))
    covered = np.zeros(color.shape[:2], np.bool_)
    covered[-rows:] = True
    return rows, covered


def _patch(color: Pixels, rng: np.random.Generator) -> tuple[Pixels, Mask]:
    _, covered = _cap(color, rng)
    return _filled(color, covered, _one_of(rng), rng), covered


def _logo(color: Pixels, rng: np.random.Generator) -> tuple[Pixels, Mask]:
    """Draw a disc with rings, beams and letters."""
    size = 512
    disc = Image.new("RGB", (size, size), tuple(int(level) for level in _one_of(rng)))
    draw = ImageDraw.Draw(disc)
    for _ in range(int(rng.integers(2, 7))):
        center, reach = rng.uniform(100, 412, 2), rng.uniform(20, 110)
        ink = tuple(int(level) for level in rng.integers(0, 256, 3))
        box = [*(center - reach), *(center + reach * rng.uniform(0.2, 1))]
        (draw.ellipse if rng.random() < 0.5 else draw.rectangle)(box, fill=ink)
    draw.text((150, 240), "PANORAMA  360", fill=tuple(int(level) for level in rng.integers(0, 256, 3)), font_size=32)
    width = color.shape[1]
    rows, covered = _cap(color, rng)
    radius = (np.arange(rows)[::-1] + 0.5)[:, None] / rows * (size / 2 - 1)
    angle = 2 * np.pi * (np.arange(width) + 0.5) / width
    x, y = size / 2 + radius * np.cos(angle), size / 2 + radius * np.sin(angle)
    out = color.copy()
    out[-rows:] = np.asarray(disc)[y.astype(int), x.astype(int)]
    return out, covered


def _blur(color: Pixels, rng: np.random.Generator) -> tuple[Pixels, Mask]:
    rows, covered = _cap(color, rng)
    reach = rows * rng.uniform(0.3, 0.8)
    wide = np.tile(color, (1, 3, 1))[:, color.shape[1] // 2 : -color.shape[1] // 2]
    smooth = np.asarray(Image.fromarray(wide).filter(ImageFilter.GaussianBlur(float(reach))))
    margin = color.shape[1] // 2
    out = color.copy()
    out[-rows:] = smooth[-rows:, margin : margin + color.shape[1]]
    return out, covered


def _caps(below: Callable[[Pixels, int], Pixels]) -> Draw:
    """Cover the floor, and half of the times the ceiling too, with what `below` makes of the rows beside so many lowest ones."""

    def draw(color: Pixels, rng: np.random.Generator) -> tuple[Pixels, Mask]:
        out = color.copy()
        rows, covered = _cap(color, rng)
        out[-rows:] = below(color, rows)
        if rng.random() < 0.5:
            rows, above = _cap(color, rng)
            covered |= above[::-1]
            out[:rows] = below(color[::-1], rows)[::-1]
        return out, covered

    return draw


def _smear(color: Pixels, rows: int) -> Pixels:
    return np.broadcast_to(color[-rows - 1], (rows, *color.shape[1:]))


def _mirror(color: Pixels, rows: int) -> Pixels:
    return color[-2 * rows : -rows][::-1]


DEFECTS: dict[str, Draw] = {
    "void_black": _void(_BLACK, (0.08, 0.45), 2.5),
    "void_white": _void(_WHITE, (0.08, 0.45), 2.5),
    "void_color": _void(None, (0.08, 0.45), 2.5),
    "holes": _void(_BLACK, (0.05, 0.25), 14.0),
    "letter_box": _letter_box,
    "columns": _columns,
    "wedges": _wedges,
    "patch": _patch,
    "logo": _logo,
    "blur": _blur,
    "smear": _caps(_smear),
    "mirror": _caps(_mirror),
}
