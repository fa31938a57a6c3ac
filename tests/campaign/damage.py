"""Damages bytes as transfers, disks and people who mean harm do."""

import random

_INTERESTING = (
    *(b"\x00", b"\xff", b"\x7f\xff\xff\xff", b"\x80\x00\x00\x00", b"-1", b"1e999", b"nan"),
    *(b"\r\n", b'"', b"<", b"{", b"\xf0\x9f"),
)


def damaged(data: bytes, chance: random.Random) -> bytes:
    """Return the bytes with one to eight changes: flipped, overwritten, cut out, repeated, inserted, or cut off."""
    changed = bytearray(data)
    for _ in range(chance.randint(1, 8)):
        if not changed:
            return bytes(changed)
        # Half of the changes are near the beginning, where headers are.
        at = chance.randrange(min(len(changed), 400) if chance.random() < 0.5 else len(changed))
        kind = chance.randrange(6)
        if kind == 0:
            changed[at] ^= 1 << chance.randrange(8)
        elif kind == 1:
            changed[at] = chance.randrange(256)
        elif kind == 2:
            del changed[at : at + chance.randint(1, 64)]
        elif kind == 3:
            changed[at:at] = changed[at : at + chance.randint(1, 64)]
        elif kind == 4:
            changed[at:at] = chance.choice(_INTERESTING)
        elif chance.random() < 0.2:
            del changed[at:]
    return bytes(changed)
