import os

from service.heap import return_freed_memory
from service.process_tree import proportional_bytes


def test_what_was_freed_below_something_that_stays_goes_back_to_the_system() -> None:
    # Blocks small enough to come from the heap; the last one, at its top, keeps it from shrinking by itself.
    blocks = [bytearray(b"x" * 50_000) for _ in range(2000)]
    last = blocks[-1]
    blocks.clear()
    before = proportional_bytes(os.getpid())
    return_freed_memory()
    assert before - proportional_bytes(os.getpid()) > 50_000_000
    assert len(last) == 50_000
