"""Client commands start at once, because nothing heavy is imported before it is needed."""

import subprocess
import sys

HEAVY = ("torch", "ray", "numpy", "open3d", "fastapi", "pydantic", "core", "redis")


def test_client_commands_import_nothing_heavy() -> None:
    program = f"import sys, service.cli; print([name for name in {HEAVY!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
