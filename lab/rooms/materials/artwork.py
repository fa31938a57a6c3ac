"""Drawn pictures: posters and paintings, rows of book spines, screens, and the view out of a window."""

import colorsys

import numpy as np
from PIL import Image, ImageDraw, ImageFilter

from panoloc.lab.rooms.materials.patterns import Rng, finished, noise
from panoloc.lab.rooms.materials.texture import Color, Texture

_TEXELS_PER_M = 160
_FRAME_M = 0.03


def picture(rng: Rng, size_m: tuple[float, float]) -> Texture:
    """Draw a framed landscape, abstract painting, portrait or poster that fills `size_m`."""
    width, height = (max(12, round(side * _TEXELS_PER_M)) for side in size_m)
    draw_content = (_landscape, _abstract, _portrait, _poster)[rng.integers(4)]
    content = draw_content(rng, width, height)
    frame = max(2, round(_FRAME_M * _TEXELS_PER_M))
    canvas = ImageDraw.Draw(content)
    tone = (30, 28, 26), (214, 206, 190), (120, 84, 48), (240, 240, 238)
    canvas.rectangle((0, 0, width - 1, height - 1), outline=tone[rng.integers(4)], width=frame)
    return Texture(np.asarray(content.convert("RGB")), size_m)


def book_spines(rng: Rng, size_m: tuple[float, float], num_shelves: int, wood: Color) -> Texture:
    """Draw the front of a full bookshelf: shelves of books and a few boxes and vases."""
    width, height = (max(12, round(side * _TEXELS_PER_M * 1.4)) for side in size_m)
    back = tuple(int(255 * 0.55 * channel) for channel in wood)
    board = tuple(int(255 * channel) for channel in wood)
    image = Image.new("RGB", (width, height), back)
    canvas = ImageDraw.Draw(image)
    shelf = height / num_shelves
    for number in range(num_shelves):
        floor = round((number + 1) * shelf) - 4
        x = 5.0
        while x < width - 9:
            if rng.random() < 0.06:
                x += rng.uniform(10, 40)
                continue
            thick, tall = rng.uniform(3, 10), rng.uniform(0.5, 0.86) * shelf
            fill = random_rgb(rng, 0.65, (0.2, 0.85))
            canvas.rectangle((x, floor - tall, min(x + thick, width - 6), floor), fill=fill)
            if thick > 4:
                stripe = floor - tall * rng.uniform(0.3, 0.85)
                canvas.rectangle(
                    (x + 1, stripe, min(x + thick, width - 6) - 1, stripe + 4), fill=random_rgb(rng, 0.5, (0.5, 1))
                )
            x += thick + 0.6
        canvas.rectangle((0, floor, width, floor + 4), fill=board)
    canvas.rectangle((0, 0, width - 1, height - 1), outline=board, width=5)
    return Texture(np.asarray(image), size_m)


def window_view(rng: Rng, size_m: tuple[float, float]) -> Texture:
    """Draw what is outside: sky, distant houses or hills, trees, lawn, behind white window bars."""
    width, height = (max(12, round(side * 140)) for side in size_m)
    rows = np.linspace(0, 1, height)[:, None, None]
    sky = np.array([0.50, 0.68, 0.92]) * (1 - rows) + np.array([0.86, 0.90, 0.94]) * rows
    clouds = np.clip(noise(rng, height, width, 5, 4), 0, 1)[..., None] * (1 - rows) * 0.45
    image = Image.fromarray((np.clip(sky + clouds, 0, 1) * 255).astype(np.uint8))
    canvas = ImageDraw.Draw(image)
    horizon = height * rng.uniform(0.55, 0.72)
    for _ in range(rng.integers(2, 6)):
        _house(canvas, rng, rng.uniform(-0.1, 0.9) * width, horizon, rng.uniform(0.12, 0.4) * height)
    canvas.rectangle((0, horizon, width, height), fill=random_rgb(rng, 0.4, (0.35, 0.55), hue=0.28))
    for _ in range(rng.integers(2, 7)):
        _tree(
            canvas, rng, rng.uniform(0, width), horizon + rng.uniform(0, 0.1) * height, rng.uniform(0.1, 0.3) * height
        )
    image = image.filter(ImageFilter.GaussianBlur(0.8))
    bars = ImageDraw.Draw(image)
    bars.rectangle((0, 0, width - 1, height - 1), outline=(236, 236, 232), width=4)
    for column in range(1, int(rng.integers(1, 4))):
        x = width * column / 3 if width > height else width / 2
        bars.rectangle((x - 2, 0, x + 2, height), fill=(236, 236, 232))
    return Texture(np.asarray(image), size_m)


def screen(rng: Rng, size_m: tuple[float, float]) -> Texture:
    """Draw a display: mostly dark with a few windows, or a film scene."""
    width, height = (max(12, round(side * _TEXELS_PER_M)) for side in size_m)
    image = Image.new("RGB", (width, height), (18, 20, 26))
    canvas = ImageDraw.Draw(image)
    for _ in range(rng.integers(2, 7)):
        x, y = rng.uniform(0, width * 0.8), rng.uniform(0, height * 0.8)
        canvas.rectangle(
            (x, y, x + rng.uniform(0.1, 0.5) * width, y + rng.uniform(0.1, 0.5) * height),
            fill=random_rgb(rng, 0.5, (0.1, 0.8)),
        )
    canvas.rectangle((0, 0, width - 1, height - 1), outline=(10, 10, 10), width=3)
    return Texture(np.asarray(image), size_m)


def foliage(rng: Rng, color: Color, size_m: tuple[float, float] = (0.6, 0.6)) -> Texture:
    """Draw leaves: light and dark blotches of one green."""
    height, width = (max(8, round(side * 90)) for side in size_m)
    blotches = (
        noise(rng, height, width, height // 5, width // 5) * 0.16
        + noise(rng, height, width, height // 2, width // 2) * 0.08
    )
    return finished(np.asarray(color) * (1 + 1.6 * blotches)[..., None], size_m)


def random_rgb(
    rng: Rng, saturation: float, value: tuple[float, float], hue: float | None = None
) -> tuple[int, int, int]:
    """Draw an sRGB byte color with at most `saturation`, a value in the range, and any or about the given hue."""
    chosen = rng.random() if hue is None else hue + rng.normal(0, 0.03)
    red, green, blue = colorsys.hsv_to_rgb(chosen % 1, saturation * rng.uniform(0.3, 1), rng.uniform(*value))
    return int(red * 255), int(green * 255), int(blue * 255)


def _landscape(rng: Rng, width: int, height: int) -> Image.Image:
    top, low = random_rgb(rng, 0.5, (0.5, 0.95)), random_rgb(rng, 0.4, (0.7, 1.0))
    rows = np.linspace(0, 1, height)[:, None, None]
    sky = np.asarray(top) * (1 - rows) + np.asarray(low) * rows
    image = Image.fromarray(np.broadcast_to(sky, (height, width, 3)).astype(np.uint8))
    canvas = ImageDraw.Draw(image)
    x = np.linspace(0, width, 12)
    for layer in range(int(rng.integers(2, 5))):
        ridge = height * (0.4 + 0.14 * layer + rng.normal(0, 0.06, len(x)))
        outline = [(0, height), *zip(x.tolist(), ridge.tolist(), strict=True), (width, height)]
        canvas.polygon(outline, fill=random_rgb(rng, 0.6, (0.2, 0.7)))
    if rng.random() < 0.5:
        cx, cy, r = rng.uniform(0.2, 0.8) * width, rng.uniform(0.15, 0.4) * height, 0.09 * min(width, height)
        canvas.ellipse((cx - r, cy - r, cx + r, cy + r), fill=random_rgb(rng, 0.5, (0.85, 1), hue=0.12))
    return image


def _abstract(rng: Rng, width: int, height: int) -> Image.Image:
    image = Image.new("RGB", (width, height), random_rgb(rng, 0.4, (0.6, 1)))
    canvas = ImageDraw.Draw(image)
    for _ in range(int(rng.integers(4, 14))):
        x, y = rng.uniform(0, width), rng.uniform(0, height)
        w, h = rng.uniform(0.08, 0.5) * width, rng.uniform(0.08, 0.5) * height
        shape = (canvas.ellipse, canvas.rectangle)[rng.integers(2)]
        shape((x - w / 2, y - h / 2, x + w / 2, y + h / 2), fill=random_rgb(rng, 0.95, (0.1, 1)))
    return image


def _portrait(rng: Rng, width: int, height: int) -> Image.Image:
    image = Image.new("RGB", (width, height), random_rgb(rng, 0.5, (0.15, 0.6)))
    canvas = ImageDraw.Draw(image)
    cx, r = width * rng.uniform(0.42, 0.58), min(width, height) * rng.uniform(0.14, 0.22)
    canvas.ellipse((cx - 2.4 * r, height * 0.66, cx + 2.4 * r, height * 1.4), fill=random_rgb(rng, 0.8, (0.2, 0.8)))
    canvas.ellipse(
        (cx - 1.2 * r, height * 0.4 - 1.7 * r, cx + 1.2 * r, height * 0.4 + r),
        fill=random_rgb(rng, 0.6, (0.1, 0.5), hue=0.07),
    )
    canvas.ellipse(
        (cx - r, height * 0.42 - 1.2 * r, cx + r, height * 0.42 + 1.3 * r),
        fill=random_rgb(rng, 0.45, (0.6, 0.95), hue=0.06),
    )
    return image


def _poster(rng: Rng, width: int, height: int) -> Image.Image:
    image = Image.new("RGB", (width, height), random_rgb(rng, 0.9, (0.3, 1)))
    canvas = ImageDraw.Draw(image)
    canvas.rectangle((width * 0.12, height * 0.1, width * 0.88, height * 0.55), fill=random_rgb(rng, 0.8, (0.2, 1)))
    cx, cy, r = width / 2, height * 0.33, min(width, height) * rng.uniform(0.1, 0.2)
    canvas.regular_polygon((cx, cy, r), int(rng.integers(3, 8)), fill=random_rgb(rng, 0.9, (0.2, 1)))
    ink = random_rgb(rng, 0.3, (0.0, 1))
    for line in range(int(rng.integers(2, 6))):
        y = height * (0.62 + 0.065 * line)
        canvas.rectangle((width * 0.14, y, width * rng.uniform(0.4, 0.86), y + max(1.0, height * 0.025)), fill=ink)
    return image


def _house(canvas: ImageDraw.ImageDraw, rng: Rng, x: float, ground: float, size: float) -> None:
    wide = size * rng.uniform(0.8, 1.8)
    canvas.rectangle((x, ground - size, x + wide, ground), fill=random_rgb(rng, 0.35, (0.55, 0.95)))
    roof = [(x - wide * 0.08, ground - size), (x + wide / 2, ground - size * 1.5), (x + wide * 1.08, ground - size)]
    canvas.polygon(roof, fill=random_rgb(rng, 0.6, (0.3, 0.6), hue=0.03))
    for column in range(3):
        for row in range(2):
            left, top = x + wide * (0.14 + 0.28 * column), ground - size * (0.85 - 0.42 * row)
            canvas.rectangle((left, top, left + wide * 0.14, top + size * 0.22), fill=(60, 70, 86))


def _tree(canvas: ImageDraw.ImageDraw, rng: Rng, x: float, ground: float, size: float) -> None:
    canvas.rectangle((x - size * 0.05, ground - size * 0.5, x + size * 0.05, ground), fill=(84, 62, 44))
    for _ in range(6):
        cx, cy, r = x + rng.normal(0, size * 0.2), ground - size * rng.uniform(0.5, 1.1), size * rng.uniform(0.16, 0.34)
        canvas.ellipse((cx - r, cy - r, cx + r, cy + r), fill=random_rgb(rng, 0.6, (0.25, 0.5), hue=0.3))
