"""Client commands start at once, because nothing heavy is imported before it is needed."""

import subprocess
import sys

HEAVY = {"torch", "ray", "numpy", "PIL", "open3d", "fastapi", "pydantic", "redis"}


LIGHT = {
    "core",
    "core.camera",
    "core.camera.camera",
    "core.errors",
    "core.options",
    "core.panorama",
    "core.panorama.image_header",
}


def test_client_commands_import_nothing_heavy() -> None:
    program = "import sys, service.cli; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split())
    assert not HEAVY & loaded
    assert {name for name in loaded if name.partition(".")[0] == "core"} == LIGHT
