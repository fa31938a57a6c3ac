"""Stops the build of a wheel or an sdist that lacks the console; everything else is in pyproject.toml."""

from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py
from setuptools.command.sdist import sdist
from setuptools.errors import FileError

CONSOLE = "service/console/built/index.html"


def require_console() -> None:
    """Raise FileError where nobody has built the console."""
    if not any(Path(folder, CONSOLE).exists() for folder in (".", "panoloc")):
        raise FileError(
            f"expected the built console in {CONSOLE}, found none: run scripts/build-console, then this again"
        )


class BuildWithConsole(build_py):
    """Copies what goes into a wheel. An editable installation reads the console from the working tree."""

    def run(self) -> None:
        """Copy the files."""
        if not self.editable_mode:
            require_console()
        super().run()


class SdistWithConsole(sdist):
    """Packs the sources together with the console, so that a wheel can be made of them without Node."""

    def run(self) -> None:
        """Write the archive."""
        require_console()
        super().run()


setup(cmdclass={"build_py": BuildWithConsole, "sdist": SdistWithConsole})
