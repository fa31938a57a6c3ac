import os
import subprocess

from panoloc.service.host.process_tree import descendants


def test_grandchildren_are_found() -> None:
    script = "sleep 30 & echo $!; wait"
    with subprocess.Popen(["/bin/sh", "-c", script], stdout=subprocess.PIPE, text=True) as shell:
        assert shell.stdout is not None
        grandchild = int(shell.stdout.readline())
        found = descendants(os.getpid())
        shell.kill()
        os.kill(grandchild, 9)
    assert found.index(shell.pid) < found.index(grandchild)
