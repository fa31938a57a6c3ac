"""The kernels for GPUs say what the tensors say: on a GPU where there is one, and on the processor, which takes them block by block."""

import ctypes
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import TypeVar

import pytest
import torch

from panoloc.core.config import StepConfig
from panoloc.core.image.level import Level
from panoloc.core.kernels import cuda, library
from panoloc.core.refine import step
from panoloc.core.refine.patches import PatchSums
from panoloc.core.refine.step import PatchEquations, PointPlanes, PoseStep, patch_equations, pose_steps
from tests.core.kernels.test_kernels import aligned

Found = TypeVar("Found", PatchEquations, PoseStep)
Both = Callable[[Callable[[], Found]], tuple[Found, Found]]


@pytest.fixture(scope="module")
def blocks(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    """Return the kernels compiled for this processor."""
    compiler = shutil.which("g++")
    if compiler is None:
        pytest.skip("no compiler")
    folder, built = Path(cuda.__file__).parent, tmp_path_factory.mktemp("blocks") / "blocks.so"
    as_threads = ["-include", str(Path(__file__).with_name("one_thread.h")), "-I", str(folder)]
    flags = ["-std=c++17", "-O1", "-shared", "-fPIC", *as_threads, "-x", "c++"]
    subprocess.run([compiler, *flags, str(folder / "pose_steps.cu"), "-o", str(built)], check=True)
    return ctypes.CDLL(str(built))


@pytest.fixture(params=["cpu", "cuda"])
def device(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> torch.device:
    """Return where the kernels run: in memory they take the place of those for processors."""
    if request.param == "cuda" and not torch.cuda.is_available():
        pytest.skip("no GPU")
    if request.param == "cpu":
        built = request.getfixturevalue("blocks")

        def launch(name: str, count: int, threads: int, *arguments: library.Argument) -> None:
            held = [library.in_a_row(part) for part in arguments]
            for number in range(count):
                built.set_block(number)
                getattr(built, name)(*map(library.as_c, held))

        monkeypatch.setattr(step, "launch", launch)
        monkeypatch.setattr(step, "has_cuda_kernel", lambda name, tensor: True)
    return torch.device(request.param)


@pytest.fixture
def both(monkeypatch: pytest.MonkeyPatch) -> Both[Found]:
    """Return what works something out by kernels for GPUs, and by tensors."""

    def of(work: Callable[[], Found]) -> tuple[Found, Found]:
        compiled = work()
        with monkeypatch.context() as without:
            for name in ("has_kernels_for", "has_cuda_kernel"):
                without.setattr(step, name, lambda *arguments: False)
            return compiled, work()

    return of


def aligned_on(device: torch.device, count: int) -> tuple[Level, PointPlanes, torch.Tensor, torch.Tensor]:
    """Return what `aligned` returns, on a device."""
    level, points, rotations, positions = aligned(count)
    held = (each.to(device) for each in (level.colors, level.places, level.rotations, level.centers))
    images = None if points.images is None else points.images.to(device)
    places, seen, weights = (each.to(device) for each in (points.positions, points.colors, points.weights))
    moved = PointPlanes(places, seen, weights, images, PatchSums(points.sums.patches.to(device)))
    colors, *cameras = held
    return Level(colors, level.rows, *cameras), moved, rotations.to(device), positions.to(device)


@pytest.mark.parametrize("count", [1, 3, 0], ids=["one image", "three images", "a sphere"])
@pytest.mark.parametrize("robust", [None, 2.0])
@pytest.mark.parametrize("focal", ["known", "other", "unknown"])
def test_the_equations_of_a_step(
    device: torch.device, both: Both[PatchEquations], count: int, robust: float | None, focal: str
) -> None:
    level, points, rotations, positions = aligned_on(device, count)
    focals = None if focal == "known" else torch.tensor([0.0, 0.05, -0.04], device=device)
    config = StepConfig(robust_scale=robust)
    compiled, tensors = both(
        lambda: patch_equations(level, points, rotations, positions, config, focals, with_focal=focal == "unknown")
    )
    for name in (field.name for field in fields(tensors)):
        found, expected = getattr(compiled, name), getattr(tensors, name)
        largest = float(expected.abs().max())
        assert largest > 0
        torch.testing.assert_close(found, expected, rtol=2e-3, atol=2e-4 * largest)


@pytest.mark.parametrize("bounds", [None, (-0.01, 0.06)])
def test_poses_after_some_steps(device: torch.device, both: Both[PoseStep], bounds: tuple[float, float] | None) -> None:
    level, points, rotations, positions = aligned_on(device, 3)
    focals = None if bounds is None else torch.tensor([0.0, 0.05, -0.01], device=device)
    config = StepConfig(max_step_m=0.02, lengthening=1)
    compiled, tensors = both(
        lambda: pose_steps(level, points, rotations, positions, focals, config, bounds, count=3, has_last=True)
    )
    assert float((tensors.positions - positions).norm(dim=1).min()) > 0.01
    for name in ("positions", "rotations", "step", *(["log_focals"] if bounds else [])):
        torch.testing.assert_close(getattr(compiled, name), getattr(tensors, name), atol=1e-4, rtol=0)


def test_points_that_nobody_sees_leave_a_pose_where_it_is(device: torch.device, both: Both[PoseStep]) -> None:
    level, points, rotations, positions = aligned_on(device, 1)
    unseen = replace(points, weights=torch.zeros_like(points.weights))
    compiled, tensors = both(lambda: pose_steps(level, unseen, rotations, positions, None, StepConfig()))
    torch.testing.assert_close(compiled.positions, positions)
    torch.testing.assert_close(compiled.equations.mass, tensors.equations.mass)
