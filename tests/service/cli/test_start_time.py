"""Client commands start at once, because nothing heavy is imported before it is needed."""

import subprocess
import sys

from tests.service.light_modules import FOR_COMMANDS, core_modules

HEAVY = {"torch", "ray", "numpy", "PIL", "open3d", "fastapi", "pydantic", "redis"}


def test_client_commands_import_nothing_heavy() -> None:
    program = "import sys, service.cli; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split())
    assert not HEAVY & loaded
    assert core_modules(loaded) == FOR_COMMANDS
