"""From raw points to a cloud: cleaned, converted, thinned and measured while they come."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panoloc.core.earth.georeference import CoordinateSystem, coordinate_system
from panoloc.core.errors import OptionsError, ScanContentError
from panoloc.core.options import FARTHEST_M, METRES_PER_UNIT
from panoloc.core.scan.frame import UNIT_TOLERANCE, ReadAs, ScanFrame
from panoloc.core.scan.judgement import judge
from panoloc.core.scan.point_cloud import Diagnostic, PointCloud
from panoloc.core.scan.reading_context import RawChunk, ReadingContext
from panoloc.core.scan.voxel_thinning import ThinnedPoints, VoxelThinner, column_bounds

# float32 resolves 0.06 mm at 1 km; farther out an offset is needed.
_LARGE_COORDINATE_M = 1000.0
_SMALLEST_PLAUSIBLE_M = 0.2
_LARGEST_PLAUSIBLE_M = 2000.0
# Of the points, how many places may be strays: null points of an export lie at one, whatever their number.
_STRAY_SHARE = 0.01
# A little above 1, for colours that were interpolated or sharpened.
_UNIT_RANGE_LIMIT = 1.01
_DARKEST_PLAUSIBLE = 16


class ScanCollector:
    """Cleans, converts, thins and measures the chunks of one scan."""

    def __init__(self, context: ReadingContext):
        self._context = context
        self._thinner = VoxelThinner(context.options.max_points_used, context.options.color_kind)
        self._colors = ColorRange()
        self._num_read = 0
        self._num_dropped = 0
        self._lowest = np.full(3, np.inf)
        self._highest = np.full(3, -np.inf)
        self._farthest: float | None = None

    def add(self, chunk: RawChunk, num_read: int | None = None) -> None:
        """Take the usable points of `chunk`. num_read: how many points they were in their file, by default as many."""
        self._num_read += len(chunk.positions) if num_read is None else num_read
        self._context.options.check_num_points(self._num_read)
        positions = chunk.positions
        if self._farthest is None and len(positions):
            self._farthest = self._farthest_of(positions)
        # The comparison is false for NaN as well.
        usable = _all_true(np.abs(positions) <= (self._farthest or FARTHEST_M))
        if chunk.colors.dtype.kind == "f":
            usable &= _all_true(np.isfinite(chunk.colors))
        num_usable = int(np.count_nonzero(usable))
        self._num_dropped += len(positions) - num_usable
        if not num_usable:
            return
        colors: NDArray[Any] = chunk.colors
        if num_usable < len(positions):
            positions, colors = positions[usable], colors[usable]
        lowest, highest = column_bounds(positions)
        self._lowest, self._highest = np.minimum(self._lowest, lowest), np.maximum(self._highest, highest)
        self._colors.observe(colors)
        self._thinner.add(positions, colors)

    def finish(self) -> PointCloud:
        """Check the whole scan and return it."""
        self._check_content()
        thinned = self._thinner.finish()
        system, is_files = self._named_system()
        brightness = (
            None if self._context.options.color_kind == "labels" else thinned.colors.mean(axis=1, dtype=np.float64)
        )
        frame, read_as = judge(self._context, system, thinned.positions, brightness)
        positions = frame.to_map(thinned.positions)
        corners = frame.to_map(np.stack([self._lowest, self._highest]))
        self._lowest, self._highest = corners.min(axis=0), corners.max(axis=0)
        positions, thinned = self._without_strays(positions, thinned)
        self._note_conversions(thinned, frame, read_as)
        offset = self._origin_offset()
        definition = self._coordinate_system(system, frame, read_as) if is_files else None
        if system is not None and not is_files and system.place(self._middle) is None:
            self._note_unused(OptionsError(system.why_outside(self._middle)), "that was given")
        return PointCloud(
            positions=(positions - offset).astype(np.float32),
            colors=self._colors.to_bytes(thinned.colors),
            origin_offset=offset,
            num_points_read=self._num_read,
            diagnostics=(*self._context.diagnostics, *self._colors.diagnostics()),
            coordinate_system=definition,
            read_as=read_as,
        )

    def _without_strays(
        self, positions: NDArray[np.float64], thinned: ThinnedPoints
    ) -> tuple[NDArray[np.float64], ThinnedPoints]:
        """Leave out what lies farther from nearly all other points than any scan reaches: float32 cannot hold both exactly."""
        if (self._highest - self._lowest).max() <= _LARGEST_PLAUSIBLE_M:
            return positions, thinned
        far = (np.abs(positions - np.median(positions, axis=0)) > _LARGEST_PLAUSIBLE_M).any(axis=1)
        places, kept = np.unique(positions[far], axis=0), positions[~far]
        if not 0 < len(places) <= max(1.0, _STRAY_SHARE * len(positions)):
            return positions, thinned
        lowest, highest = column_bounds(kept)
        if (highest - lowest).max() > _LARGEST_PLAUSIBLE_M:
            return positions, thinned  # a long scan, or another unit
        self._context.note(
            "stray_points",
            f"{len(positions) - len(kept):,} of {len(positions):,} points were left out, the first of them at "
            f"({', '.join(f'{value:,.0f}' for value in places[0])}): they lie more than {_metres(_LARGEST_PLAUSIBLE_M)} from all others.",
            "warning",
        )
        self._lowest, self._highest = lowest, highest
        return kept, replace(thinned, positions=thinned.positions[~far], colors=thinned.colors[~far])

    def _farthest_of(self, positions: NDArray[np.float64]) -> float:
        """Return how far from the origin points may be, in the unit of the file."""
        unit = self._context.options.unit
        if unit != "auto":
            return FARTHEST_M / METRES_PER_UNIT[unit]
        finite = np.abs(positions[np.isfinite(positions)])
        is_near = not len(finite) or np.median(finite) <= FARTHEST_M
        return FARTHEST_M if is_near else FARTHEST_M / min(METRES_PER_UNIT.values())

    def _named_system(self) -> tuple[CoordinateSystem | None, bool]:
        """Return the coordinate system of the coordinates, and whether the file names it."""
        given, named = self._context.options.coordinate_system, self._context.coordinate_system
        if given is None and named is not None:
            try:
                return coordinate_system(named), True
            except OptionsError as error:
                self._note_unused(error)
        return None if given is None else coordinate_system(given), False

    @property
    def _middle(self) -> tuple[float, float, float]:
        x, y, z = ((self._lowest + self._highest) / 2).tolist()
        return x, y, z

    def _note_unused(self, error: OptionsError, whose: str = "of the file") -> None:
        message = f"The coordinate system {whose} is not used: {error}."
        self._context.note("coordinate_system_unused", message, "warning")

    def _coordinate_system(self, system: CoordinateSystem | None, frame: ScanFrame, read_as: ReadAs) -> str | None:
        """Return the coordinate system that the file names, None where the coordinates cannot be in it."""
        assert system is not None
        try:
            if frame.up_axis != "z":
                raise OptionsError(f"it has z up, but the given up axis of the scan is {frame.up_axis}")
            if read_as.unit_from == "given" and abs(system.metres_per_unit / frame.metres - 1) > UNIT_TOLERANCE:
                raise OptionsError(
                    f"its unit is {system.metres_per_unit:.7g} m, but the given unit is {read_as.unit}; register the scan "
                    "again with the unit of its coordinates"
                )
            place = system.place(self._middle)
            if place is None:
                raise OptionsError(system.why_outside(self._middle))
        except OptionsError as error:
            self._note_unused(error)
            return None
        self._context.note(
            "coordinate_system",
            f"Coordinates are in {system.name}, as the file says; at the middle of the scan, {place.latitude_deg:.5f}, "
            f"{place.longitude_deg:.5f}, grid north is {place.convergence_deg:+.3f} degrees clockwise from true north.",
        )
        return system.definition

    def _check_content(self) -> None:
        if not self._num_read:
            raise ScanContentError("The file holds no points. Export the scan again.")
        num_usable = self._num_read - self._num_dropped
        if not num_usable:
            raise ScanContentError(
                f"None of the {self._num_read:,} points has finite coordinates and colours (NaN, infinite or absurdly "
                "far away). Export the scan without invalid points."
            )
        if num_usable == 1:
            raise ScanContentError("The scan has a single usable point; a map needs many. Export the whole scan.")
        if not np.any(self._highest > self._lowest):
            raise ScanContentError(
                f"All {num_usable:,} usable points lie at the same position "
                f"({', '.join(f'{value:g}' for value in self._lowest)}): the scan has no extent. Check the coordinate "
                "columns and export the scan again."
            )
        self._colors.check()

    def _note_conversions(self, thinned: ThinnedPoints, frame: ScanFrame, read_as: ReadAs) -> None:
        note, options = self._context.note, self._context.options
        if self._num_dropped:
            note(
                "non_finite_points",
                f"{self._num_dropped:,} of {self._num_read:,} points were dropped: their coordinates or colours are "
                f"not finite or lie beyond {_metres(FARTHEST_M)}.",
                "warning",
            )
        if frame.metres != 1.0 or frame.height_metres != 1.0:
            note("unit_converted", f"Coordinates were converted {_conversion(frame, read_as)}.")
        if frame.up_axis != "z":
            note(
                "axes_converted",
                f"The scan is {frame.up_axis}-up; (x, y, z) became {frame.turn_words}, so that z is up.",
            )
        extent = (self._highest - self._lowest).max()
        if not _SMALLEST_PLAUSIBLE_M <= extent <= _LARGEST_PLAUSIBLE_M:
            note(
                "suspicious_extent",
                f"The scan measures {_metres(extent)} if its unit is {read_as.unit!r}; check the unit, "
                "and set it to m, cm, mm, ft or us-ft.",
                "warning",
            )
        if thinned.voxel_size is not None:
            kept = "the mean" if options.color_kind == "rgb" else "the first point"
            note(
                "thinned",
                f"{self._num_read - self._num_dropped:,} points were thinned to {len(thinned.positions):,}: "
                f"{kept} of each voxel of {_metres(thinned.voxel_size * frame.metres)}.",
            )

    def _origin_offset(self) -> NDArray[np.float64]:
        if max(np.abs(self._lowest).max(), np.abs(self._highest).max()) <= _LARGE_COORDINATE_M:
            return np.zeros(3)
        offset = np.rint((self._lowest + self._highest) / 2)
        self._context.note(
            "large_coordinates",
            f"Coordinates reach {np.abs([self._lowest, self._highest]).max():,.0f} m; the offset "
            f"({', '.join(f'{value:.0f}' for value in offset + 0.0)}) is subtracted before conversion to float32 and "
            "added back to every returned position.",
            "warning",
        )
        return np.asarray(offset, np.float64)


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
        return np.clip(np.rint(colors * self._factor), 0, 255).astype(np.uint8)

    def diagnostics(self) -> list[Diagnostic]:
        """Say which range was found where it was not obvious."""
        found = []
        if self._dtype == np.uint16 and self._highest <= 255:
            found.append(Diagnostic("color_range", "info", "8-bit colours in 16-bit fields: taken as 0..255."))
        elif self._factor != 1.0:
            top = "1" if self._factor == 255.0 else "65535"
            found.append(Diagnostic("color_range", "info", f"Colours of the range 0..{top} were scaled to 0..255."))
        brightest = self._highest * self._factor
        if brightest < _DARKEST_PLAUSIBLE:
            said = f"The brightest colour value is {brightest:.0f} of 255: the scan is dark, or its range is unusual."
            found.append(Diagnostic("dark_colors", "warning", said))
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


_SOURCES = {"file": ", as the file says", "judged": ", by the heights of what was scanned"}


def _conversion(frame: ScanFrame, read_as: ReadAs) -> str:
    """Return the units that coordinates were converted from, and who says so."""
    unit, height_unit = read_as.unit or f"{frame.metres:.9g} m", read_as.height_unit or f"{frame.height_metres:.9g} m"
    source = _SOURCES.get(read_as.unit_from if frame.metres != 1.0 else read_as.height_unit_from, "")
    if frame.metres == frame.height_metres:
        return f"from {unit} to metres{source}"
    return f"from {unit}, heights from {height_unit}, to metres{source}"


def _metres(length: float) -> str:
    """Return a length as people write it, whatever its size."""
    return f"{length:,.0f} m" if length >= 100 else f"{length:.3g} m"


def _all_true(flags: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Tell which rows of (n, 3) flags are all true, several times as fast as all(axis=1)."""
    return flags[:, 0] & flags[:, 1] & flags[:, 2]
