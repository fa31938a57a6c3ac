"""LZF decompression, the codec inside binary_compressed PCD files (format of Marc Lehmann's liblzf)."""

# One three-byte reference yields at most this many bytes: more is a bomb or damage.
MAX_RATIO = 88
_LITERAL_LIMIT = 32
_LONG_LENGTH = 7


def decompress_lzf(data: bytes, num_bytes: int) -> bytes:
    """Return the `num_bytes` bytes that `data` decompresses to; raise ValueError when it does not.

    A byte below 32 announces that many literal bytes plus one; any other begins a reference: three bits of length
    (seven: one more length byte follows) and thirteen bits of distance into what is already there.
    """
    output = bytearray()
    position, end = 0, len(data)
    try:
        while position < end:
            control = data[position]
            position += 1
            if control < _LITERAL_LIMIT:
                output += data[position : position + control + 1]
                position += control + 1
                continue
            length = control >> 5
            if length == _LONG_LENGTH:
                length += data[position]
                position += 1
            start = len(output) - ((control & 0x1F) << 8) - data[position] - 1
            position += 1
            _repeat(output, start, length + 2)
            if len(output) > num_bytes:
                break
    except IndexError:
        raise ValueError("the compressed data ends in the middle of a reference") from None
    if len(output) != num_bytes or position != end:
        raise ValueError(f"the compressed data gives {len(output):,} bytes, expected {num_bytes:,}")
    return bytes(output)


def _repeat(output: bytearray, start: int, length: int) -> None:
    if start < 0:
        raise ValueError("the compressed data refers to bytes before its beginning")
    piece = output[start : start + length]
    if len(piece) < length:  # the reference overlaps what it writes: the piece repeats itself
        piece = (piece * (length // len(piece) + 1))[:length]
    output += piece
