"""What `panoloc` offers by name, and the example that shows how to use it."""

import doctest
import io
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest
from PIL import Image

import panoloc
from panoloc.core.scan.ply.writer import encode_ply
from tests.core.built_maps import POSE
from tests.core.painted_box import PaintedBox


@pytest.mark.slow
def test_the_example_in_the_docstring_runs(tmp_path: Path) -> None:
    box = PaintedBox(seed=3, size_m=(3.4, 3.6, 2.5))
    photo, scan_path = io.BytesIO(), tmp_path / "box.ply"
    scan_path.write_bytes(encode_ply(box.scan(12_000)))
    Image.fromarray(box.panorama(POSE).color).save(photo, "png")
    names = {"scan_path": scan_path, "photo_bytes": photo.getvalue()}
    (example,) = doctest.DocTestFinder(recurse=False).find(panoloc, globs=names)
    said: list[str] = []
    failed, attempted = doctest.DocTestRunner().run(example, out=said.append)
    assert attempted == 5
    assert failed == 0, "".join(said)


def test_every_public_name_is_there_and_no_other() -> None:
    for name in panoloc.__all__:
        assert getattr(panoloc, name) is not None, name
    assert panoloc.__version__ == metadata.version("panoloc")
    with pytest.raises(AttributeError, match=r"it offers Ambiguous, .*read_scan"):
        panoloc.nothing_of_the_kind  # noqa: B018


def test_importing_panoloc_loads_neither_torch_nor_numpy() -> None:
    program = "import panoloc, panoloc.core.errors, panoloc.core.options, sys; print({'torch', 'numpy', 'open3d'} & set(sys.modules))"
    said = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert said.stdout.strip() == "set()"
