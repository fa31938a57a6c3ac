"""Client commands start at once, because nothing heavy is imported before it is needed."""

import subprocess
import sys

from tests.service.light_modules import FOR_COMMANDS, core_modules

HEAVY = {"torch", "ray", "numpy", "PIL", "open3d", "fastapi", "pydantic", "redis"}


def test_an_interrupt_while_modules_are_imported_ends_it_without_a_traceback() -> None:
    """Half of the third of a second that the command needs to start."""
    program = (
        "import os, signal, sys\n"
        # What a shell starts in the background ignores it.
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "class Interrupted:\n"
        "    def find_spec(self, name, *_):\n"
        "        if name == 'typer':\n"
        "            os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.meta_path.insert(0, Interrupted())\n"
        "from panoloc.service.cli import main\n"
        "main()\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")


def test_client_commands_import_nothing_heavy() -> None:
    program = "import sys, panoloc.service.cli.entry; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split())
    assert not HEAVY & loaded
    assert core_modules(loaded) == FOR_COMMANDS
