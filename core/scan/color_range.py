"""Find out over a whole scan which range its colours use, and bring them to 0..255."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from panoloc.core.errors import ScanContentError
from panoloc.core.scan.point_cloud import Diagnostic

# A little above 1, for colours that were interpolated or sharpened.
_UNIT_RANGE_LIMIT = 1.01
_DARKEST_PLAUSIBLE = 16


class ColorRange:
    """Watches the raw colours of every chunk (see `RawChunk`) and scales them at the end.

    uint8 is taken as it is. uint16 is 8-bit colour in 16-bit fields when nothing exceeds 255, else 16-bit colour.
    float64 is 0..1, 0..255 or 0..65535 by its largest value.
    """

    def __init__(self) -> None:
        self._lowest = 0.0
        self._highest = 0.0
        self._used_bits = 0
        self._dtype: np.dtype[Any] = np.dtype(np.uint8)

    def observe(self, colors: NDArray[Any]) -> None:
        """Take note of finite raw colours, (n, 3)."""
        if not len(colors):
            return
        self._dtype = colors.dtype
        self._highest = max(self._highest, float(colors.max()))
        if colors.dtype == np.uint16:
            self._used_bits |= int(np.bitwise_or.reduce(colors, axis=None))
        elif colors.dtype.kind == "f":
            self._lowest = min(self._lowest, float(colors.min()))

    def check(self) -> None:
        """Raise ScanContentError for colours that are all zero or in no known range."""
        if self._highest == 0 and self._lowest == 0:
            raise ScanContentError(
                "Every point of the scan has the colour (0, 0, 0): the file has colour fields, but they are empty. "
                "Colour the scan from its photos before exporting it."
            )
        if self._lowest < -0.01 or self._highest > 65535:
            raise ScanContentError(
                f"The colours run from {self._lowest:g} to {self._highest:g}; expected 0..1, 0..255 or 0..65535. "
                "Check which columns hold the colours and export the scan again."
            )

    def to_bytes(self, colors: NDArray[Any]) -> NDArray[np.uint8]:
        """Scale raw colours (or means of them), (n, 3), to uint8."""
        if colors.dtype == np.uint8:
            return colors
        scaled = np.rint(colors * self._factor)
        return np.clip(scaled, 0, 255).astype(np.uint8)

    def diagnostics(self) -> list[Diagnostic]:
        """Say which range was found where it was not obvious."""
        found = []
        if self._dtype == np.uint16 and self._highest <= 255:
            found.append(Diagnostic("color_range", "info", "8-bit colours in 16-bit fields: taken as 0..255."))
        elif self._factor != 1.0:
            top = "1" if self._factor == 255.0 else "65535"
            found.append(Diagnostic("color_range", "info", f"Colours of the range 0..{top} were scaled to 0..255."))
        if self._highest * self._factor < _DARKEST_PLAUSIBLE:
            brightest = self._highest * self._factor
            message = (
                f"The brightest colour value is {brightest:.0f} of 255: the scan is dark, or its range is unusual."
            )
            found.append(Diagnostic("dark_colors", "warning", message))
        return found

    @property
    def _factor(self) -> float:
        if self._dtype == np.uint8:
            return 1.0
        if self._dtype.kind == "f" and self._highest <= _UNIT_RANGE_LIMIT:
            return 255.0
        if self._highest <= 255:
            return 1.0
        # Bytes moved to the upper half (value * 256) against the full 16-bit range.
        is_shifted = self._dtype == np.uint16 and self._used_bits & 0xFF == 0
        return 1 / 256 if is_shifted else 255 / 65535
