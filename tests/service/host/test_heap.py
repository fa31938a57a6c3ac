import os
import subprocess
import sys

from service.host.heap import return_freed_memory
from service.host.process_tree import proportional_bytes


def test_what_was_freed_below_something_that_stays_goes_back_to_the_system() -> None:
    # Blocks small enough to come from the heap; the last one, at its top, keeps it from shrinking by itself.
    blocks = [bytearray(b"x" * 50_000) for _ in range(2000)]
    last = blocks[-1]
    blocks.clear()
    before = proportional_bytes(os.getpid())
    return_freed_memory()
    assert before - proportional_bytes(os.getpid()) > 50_000_000
    assert len(last) == 50_000


def test_what_was_freed_is_kept_until_it_is_asked_back() -> None:
    script = (
        "import os; from service.host.heap import keep_freed_memory, return_freed_memory\n"
        "from service.host.process_tree import proportional_bytes as size\n"
        "keep_freed_memory()\n"
        "block = bytearray(b'x' * 20_000_000); del block\n"  # would be mapped on its own, and unmapped
        "kept = size(os.getpid()); return_freed_memory(); print(kept - size(os.getpid()))"
    )
    done = subprocess.run([sys.executable, "-c", script], check=True, capture_output=True, text=True)
    assert int(done.stdout) > 15_000_000
