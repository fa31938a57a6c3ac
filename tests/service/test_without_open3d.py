"""Nothing that the service does needs Open3D, and nothing that a fork server loads asks for CUDA."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PROGRAM = """
import sys, torch
has_cuda, torch.cuda.is_available = torch.cuda.is_available, None  # what asks for CUDA while it is loaded, before a fork, fails
sys.modules["open3d"] = None  # as if it were not installed
from pathlib import Path
import panoloc.service.serve, panoloc.service.pool.child, panoloc.service.worker.localization_worker, panoloc.service.worker.registrar
torch.cuda.is_available = has_cuda
from panoloc.core.camera.rig import Rig
from panoloc.core.map.map_builder import build_map_index
from panoloc.core.localizer import Localizer
from panoloc.core.options import IndexOptions
from panoloc.core.scan.reading import read_scan
from panoloc.core.scan.ply.writer import write_ply
from tests.core.painted_box import PaintedBox, rotation_of
from panoloc.core.geometry.pose import Pose
import numpy as np
box = PaintedBox(seed=3)
write_ply(Path(sys.argv[1]), box.scan())
index = build_map_index(read_scan(Path(sys.argv[1])), IndexOptions(spacing_m=0.8))
pose = Pose(rotation_of(130.0, 8.0, -5.0), np.array([1.7, 2.4, 1.5]))
print(Localizer(device="cpu").localize(Rig.of_panorama(box.panorama(pose)), [index]).status)
"""


@pytest.mark.slow
def test_a_scan_is_registered_and_a_panorama_localized_where_open3d_is_missing(tmp_path: Path) -> None:
    command = [sys.executable, "-c", PROGRAM, str(tmp_path / "scan.ply")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=240, check=False)
    assert done.stdout.split() == ["localized"], done.stderr
