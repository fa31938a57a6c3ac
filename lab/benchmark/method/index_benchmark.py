"""Size of an encoded map index, and how long encoding and decoding take."""

from dataclasses import dataclass

import torch

from core.index.map_codec import decode_map_index, encode_map_index
from core.index.map_index import MapIndex
from lab.benchmark.sizes import Sizes
from lab.benchmark.timing import Spread, repeated


@dataclass(frozen=True)
class IndexFigures:
    """encoded_bytes: as stored; resident_bytes: as a worker holds it. decode: up to the arrays on the device."""

    points: int
    starts: int
    encoded_bytes: int
    resident_bytes: int
    encode: Spread
    decode: Spread


def time_index(index: MapIndex, sizes: Sizes, device: torch.device) -> IndexFigures:
    """Encode and decode an index repeatedly."""
    times = sizes.repeats, device, sizes.warm_ups
    encoded = encode_map_index(index)
    return IndexFigures(
        points=index.num_points,
        starts=index.num_starts,
        encoded_bytes=len(encoded),
        resident_bytes=index.num_bytes,
        encode=repeated(lambda: encode_map_index(index), *times),
        decode=repeated(lambda: decode_map_index(encoded, device), *times),
    )
