import os
import subprocess
import sys

import psutil
import pytest

from panoloc.lab.process_memory import descendants, family_bytes, proportional_bytes


def test_a_process_that_touches_more_memory_counts_more() -> None:
    script = "data = bytearray(50_000_000); print('ready', flush=True); input()"
    with subprocess.Popen(
        [sys.executable, "-c", script], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as child:
        assert child.stdout is not None
        child.stdout.readline()
        bytes_held = proportional_bytes(child.pid)
        family = family_bytes(os.getpid())
        child.kill()
    assert 50_000_000 < bytes_held < 90_000_000
    assert sum(family.values()) > bytes_held


def test_a_process_that_is_gone_has_no_memory() -> None:
    with subprocess.Popen(["/bin/true"]) as child:
        child.wait()
    with pytest.raises(psutil.NoSuchProcess, match=str(child.pid)):
        proportional_bytes(child.pid)


def test_grandchildren_are_found_after_their_parents() -> None:
    script = "sleep 30 & echo $!; wait"
    with subprocess.Popen(["/bin/sh", "-c", script], stdout=subprocess.PIPE, text=True) as shell:
        assert shell.stdout is not None
        grandchild = int(shell.stdout.readline())
        found = descendants(os.getpid())
        shell.kill()
        os.kill(grandchild, 9)
    assert found.index(shell.pid) < found.index(grandchild)
