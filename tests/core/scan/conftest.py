"""A way to write files of every format by hand."""

from pathlib import Path

import pytest

from tests.core.scan.scan_files import ScanFile


@pytest.fixture
def scan_file(tmp_path: Path) -> ScanFile:
    """Write a file into the test's folder and return its path."""

    def write(name: str, content: bytes | str) -> Path:
        path = tmp_path / name
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return path

    return write
