"""Builds the kernels, and stops the build of a wheel or an sdist that lacks the console; everything else is in pyproject.toml."""

import platform
import zlib
from pathlib import Path

from setuptools import Extension, setup
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


# Of the levels of x86-64 the best that a processor has is chosen at run time (panoloc.core.kernels.library).
BUILDS = {"baseline": [], "x86_64_v3": ["-march=x86-64-v3"], "x86_64_v4": ["-march=x86-64-v4"]}
# Sums may be reordered, so that loops over points become loops over vectors; infinities and what is no number keep their meaning.
FLAGS = [
    "-std=c++17",
    "-O3",
    "-fno-math-errno",
    "-fno-trapping-math",
    "-fno-signed-zeros",
    "-fassociative-math",
    "-Wno-psabi",
    "-g0",
]


def kernels() -> list[Extension]:
    """Return the builds of the kernels. Without a compiler none is made, and tensors do their work, several times as slowly."""
    folder = Path("core/kernels")
    sources = [str(path) for path in sorted(folder.glob("*.cpp"))]
    # As `panoloc.core.kernels.library` has it, which refuses a build of other sources.
    checksum = zlib.crc32(b"".join(path.read_bytes() for path in sorted((*folder.glob("*.cpp"), *folder.glob("*.h")))))
    builds = BUILDS if platform.machine().lower() in ("x86_64", "amd64") else {"baseline": []}
    return [
        Extension(
            f"panoloc.core.kernels._{name}",
            sources,
            depends=[str(path) for path in sorted(folder.glob("*.h"))],
            extra_compile_args=[*FLAGS, *flags, f"-DSOURCES={checksum}"],
            extra_link_args=["-pthread"],
            language="c++",
            optional=True,
        )
        for name, flags in builds.items()
    ]


setup(ext_modules=kernels(), cmdclass={"build_py": BuildWithConsole, "sdist": SdistWithConsole})
