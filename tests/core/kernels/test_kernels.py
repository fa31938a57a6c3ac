"""The compiled kernels say what the tensors say, candidate by candidate and pixel by pixel; without them tensors do the work."""

import logging
import shutil
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pytest
import torch

from panoloc.core.config import StepConfig
from panoloc.core.decide.agreement import agreement
from panoloc.core.features.canonical import CanonicalColors
from panoloc.core.features.equalization import equalize
from panoloc.core.features.line_support import LineSupport, edges_of_photos
from panoloc.core.features.local_contrast import local_contrast
from panoloc.core.features.patch_descriptors import patch_scores
from panoloc.core.geometry.distinct_poses import first_distinct
from panoloc.core.geometry.rotations import even_directions, rotation_from_vector, uniform_rotations
from panoloc.core.geometry.sphere_window import SphereWindow
from panoloc.core.image.level import Level
from panoloc.core.image.photo_window import PhotoOnWindow, photo_on_window
from panoloc.core.image.rig_pyramid import RigPyramid
from panoloc.core.kernels import library
from panoloc.core.map.retrieval_vectors import RetrievalVectors, retrieval_vectors
from panoloc.core.query.map_query import PreparedRig
from panoloc.core.refine.patches import PatchSums, patch_numbers
from panoloc.core.refine.step import PatchEquations, PointPlanes, PoseStep, patch_equations, pose_steps
from panoloc.core.render.comparison import Comparison, RigView
from panoloc.core.render.render_cloud import ViewParts, make_render_cloud
from panoloc.core.render.synthetic_view import SyntheticViews, depths_from, render_views
from panoloc.core.search.map_search import patch_scores_of
from panoloc.core.search.pixel_scores import pixel_scores, scores_of_every_pose
from panoloc.core.search.position_sweep import swept
from panoloc.core.search.retrieval import scores_of_maps
from tests.core.built_maps import BOX, OTHER_BOX, map_of, tensors_of
from tests.core.image.painted_photos import SIDEWAYS, photo_of
from tests.core.image.test_level import POSITION, ROTATION, SPHERE, level_of, points_in_view
from tests.core.search.found_candidates import CONFIG, RIGS, query
from tests.core.test_distinct_poses import NEAR

Found = TypeVar("Found")
Equations = Callable[..., tuple[PatchEquations, PatchEquations]]
Views = Callable[..., tuple[SyntheticViews, SyntheticViews]]
Comparisons = Callable[..., tuple[Comparison, Comparison]]
Numbers = Callable[..., tuple[torch.Tensor, torch.Tensor]]
BUILDS = sorted(Path(library.__file__).parent.glob("_*.so"))


@pytest.fixture(params=[pytest.param(path, id=path.name.split(".")[0]) for path in BUILDS])
def both(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> Callable[[Callable[[], Found]], tuple[Found, Found]]:
    """Return what works something out by a build of the kernels, and by tensors."""
    if str(request.param) not in runnable():
        pytest.skip("this processor has not what the build needs")
    build = library.loaded(request.param)

    def of(work: Callable[[], Found]) -> tuple[Found, Found]:
        found = []
        for each in (build, None):
            monkeypatch.setattr(library, "kernels", lambda each=each: each)
            found.append(work())
        return found[0], found[1]

    return of


def runnable() -> set[str]:
    level = torch.backends.cpu.get_cpu_capability()
    names = library.BUILDS.get(level, ("baseline",))
    return {str(path) for path in BUILDS for name in names if path.name.startswith(f"_{name}.")}


def test_there_are_kernels_and_the_best_of_them_are_taken() -> None:
    """Where the tests run there is a compiler."""
    taken = library.kernels()
    assert taken is not None
    best = library.BUILDS.get(torch.backends.cpu.get_cpu_capability(), ("baseline",))[0]
    assert Path(taken._name).name.startswith(f"_{best}.")


@pytest.mark.parametrize("words", ["missing", "older than their sources", "unusable"])
def test_without_kernels_tensors_do_the_work_and_the_log_says_so(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, caplog: pytest.LogCaptureFixture, words: str
) -> None:
    if words == "unusable":
        for path in BUILDS:
            (tmp_path / path.name).write_bytes(path.name.encode())
    elif words != "missing":
        folder = Path(library.__file__).parent
        for path in (*folder.glob("*.cpp"), *folder.glob("*.h"), *folder.glob("_*.so")):
            shutil.copy(path, tmp_path)
        with (tmp_path / "step.cpp").open("a", encoding="utf-8") as source:
            source.write("// changed\n")
    monkeypatch.setattr(library, "__file__", str(tmp_path / "library.py"))
    library.kernels.cache_clear()
    try:
        with caplog.at_level(logging.WARNING):
            assert library.kernels() is None
            assert not library.has_kernels_for(torch.zeros(1))
    finally:
        library.kernels.cache_clear()
    (record,) = caplog.records
    assert record.message.startswith(f"the compiled kernels are {words}")
    assert record.message.endswith(": queries take several times as long; scripts/install builds them")


def test_a_damaged_build_is_passed_over_for_the_next(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    best, *others = library.BUILDS.get(torch.backends.cpu.get_cpu_capability(), ("baseline",))
    if not others:
        pytest.skip("this processor has one build")
    folder = Path(library.__file__).parent
    for path in (*folder.glob("*.cpp"), *folder.glob("*.h"), *BUILDS):
        shutil.copy(path, tmp_path)
    for path in tmp_path.glob(f"_{best}.*so"):
        path.write_bytes(b"")
    monkeypatch.setattr(library, "__file__", str(tmp_path / "library.py"))
    library.kernels.cache_clear()
    try:
        assert library.kernels_name() == others[0]
    finally:
        library.kernels.cache_clear()


def test_kernels_are_for_single_precision_in_memory() -> None:
    assert library.has_kernels_for(torch.zeros(1))
    assert not library.has_kernels_for(torch.zeros(1, dtype=torch.float64))
    assert not library.has_kernels_for(torch.zeros(1, device="meta"))


def aligned(count: int, of: int = 700) -> tuple[Level, PointPlanes, torch.Tensor, torch.Tensor]:
    """Return a level of so many images, 0 for a sphere with a hole, what three candidates align on it, and their poses."""
    rng = torch.Generator().manual_seed(count)
    if count:
        level, (place, images) = level_of(count), points_in_view(count, of)
    else:
        level = level_of(1, SPHERE)
        level = replace(level, colors=level.colors.clone())
        level.colors[3, 60:90, 100:160] = 0
        place = ((1 + torch.rand((of, 1), generator=rng)) * even_directions(of)).T[None] + POSITION[:, None]
        images = torch.zeros((1, of), dtype=torch.int64)
    order = patch_numbers((place[0].T - POSITION) @ ROTATION, 15.0).sort(stable=True)
    turns = rotation_from_vector(0.03 * torch.randn((3, 3), generator=rng))
    some = place[:, :, order.indices].expand(3, -1, -1).contiguous()
    weights = (torch.rand((3, of), generator=rng) - 0.2).clamp_min(0)
    colors = torch.rand((3, 3, of), generator=rng)
    # Half of what was scanned is what the images show.
    shown, _ = level.sample_points(some[:1], images[:, order.indices], ROTATION[None], POSITION[None])
    colors[..., ::2] = shown.color[..., ::2]
    given = images[:, order.indices].expand(3, -1).contiguous() if count > 1 else None
    planes = PointPlanes(some, colors, weights, given, PatchSums(order.values))
    return level, planes, ROTATION @ turns, POSITION + 0.02 * torch.randn((3, 3), generator=rng)


@pytest.mark.parametrize("count", [1, 3, 0], ids=["one image", "three images", "a sphere"])
@pytest.mark.parametrize("robust", [None, 2.0])
@pytest.mark.parametrize("focal", ["known", "other", "unknown"])
def test_the_equations_of_a_step(both: Equations, count: int, robust: float | None, focal: str) -> None:
    level, points, rotations, positions = aligned(count)
    focals = None if focal == "known" else torch.tensor([0.0, 0.05, -0.04])
    config = StepConfig(robust_scale=robust)
    compiled, tensors = both(
        lambda: patch_equations(level, points, rotations, positions, config, focals, with_focal=focal == "unknown")
    )
    for name in (field.name for field in fields(tensors)):
        found, expected = getattr(compiled, name), getattr(tensors, name)
        assert found.shape == expected.shape
        largest = float(expected.abs().max())
        assert largest > 0
        torch.testing.assert_close(found, expected, rtol=2e-3, atol=2e-4 * largest)


@pytest.mark.parametrize("bounds", [None, (-0.01, 0.06)])
def test_poses_after_some_steps(
    both: Callable[..., tuple[PoseStep, PoseStep]], bounds: tuple[float, float] | None
) -> None:
    level, points, rotations, positions = aligned(3)
    rotations = rotations.mT.contiguous().mT  # the same, as they seldom lie in memory
    focals = None if bounds is None else torch.tensor([0.0, 0.05, -0.01])
    config = StepConfig(max_step_m=0.02, lengthening=1)
    compiled, tensors = both(
        lambda: pose_steps(level, points, rotations, positions, focals, config, bounds, count=3, has_last=True)
    )
    assert float((tensors.positions - positions).norm(dim=1).min()) > 0.01
    torch.testing.assert_close(compiled.positions, tensors.positions, atol=1e-4, rtol=0)
    torch.testing.assert_close(compiled.rotations, tensors.rotations, atol=1e-4, rtol=0)
    torch.testing.assert_close(compiled.step, tensors.step, atol=1e-4, rtol=0)
    if bounds is not None:
        assert compiled.log_focals is not None
        torch.testing.assert_close(compiled.log_focals, tensors.log_focals, atol=1e-4, rtol=0)


def test_a_pose_that_is_no_number_is_survived(both: Equations) -> None:
    level, points, rotations, positions = aligned(1)
    positions[1] = torch.nan
    compiled, _ = both(lambda: patch_equations(level, points, rotations, positions, StepConfig()))
    assert bool(compiled.loss[[0, 2]].isfinite().all())


@pytest.mark.parametrize("part", ["whole", "part"])
@pytest.mark.parametrize("with_points", [True, False])
def test_views(both: Views, part: str, with_points: bool) -> None:
    """Points lie from a hand's breadth to 30 m away, so that each thinning and each size of a footprint occurs."""
    rng = np.random.default_rng(0)
    towards = rng.normal(size=(40_000, 3))
    towards *= (0.1 * 300 ** rng.uniform(size=40_000) / np.linalg.norm(towards, axis=1))[:, None]
    order = np.lexsort(np.floor(towards).T)  # neighbours together
    places, colors = torch.from_numpy(towards[order]).float(), torch.from_numpy(rng.uniform(size=(40_000, 3))).float()
    cloud, centers = make_render_cloud(places, colors, 0.05), torch.tensor([[0.0, 0.0, 0.0], [0.4, -0.3, 0.2]])
    turns = uniform_rotations(12)[4:6]
    wanted: int | ViewParts = 64
    if part == "part":
        wanted = ViewParts(turns, SphereWindow(64, 16, 48, 32, 40), turns[:, None, :, 0], torch.tensor([0.9]))
    compiled, tensors = both(lambda: render_views(cloud, centers, wanted, with_points))
    assert float(tensors.valid.float().mean()) > 0.3
    assert float((compiled.valid != tensors.valid).float().mean()) < 1e-3
    same = compiled.valid & tensors.valid
    assert bool(torch.isclose(compiled.depth[same], tensors.depth[same], rtol=1e-4).float().mean() > 0.998)
    assert bool(torch.isclose(compiled.color[same], tensors.color[same], atol=1e-3).float().mean() > 0.995)
    assert compiled.point.shape == tensors.point.shape
    if part == "whole":
        assert torch.equal(depths_from(cloud, centers, 64), tensors.depth)
    if with_points:
        assert float((compiled.point != tensors.point).float().mean()) < 2e-3


def test_views_of_more_channels_are_drawn_by_tensors(both: Views) -> None:
    places, colors = torch.rand((500, 3)), torch.rand((500, 4))
    cloud = make_render_cloud(places, colors, 0.05)
    compiled, tensors = both(lambda: render_views(cloud, torch.tensor([[0.5, 0.5, 0.5]]), 32))
    assert compiled.color.shape[-1] == 4
    assert torch.equal(compiled.color, tensors.color)


@pytest.mark.parametrize("name", list(RIGS))
@pytest.mark.parametrize("log_focal", [None, 0.1])
def test_what_images_show_at_rendered_pixels(both: Comparisons, name: str, log_focal: float | None) -> None:
    rig, pose = RIGS[name]
    at, focals = tensors_of(pose), None if log_focal is None else torch.tensor([log_focal])

    def compared() -> Comparison:
        return RigView(RigPyramid(rig, 256, None, "cpu"), 8.0).compare(map_of(BOX).render_cloud, *at, 64, True, focals)

    compiled, tensors = both(compared)
    assert float((tensors.image >= 0).float().mean()) > 0.2
    assert float((compiled.image != tensors.image).float().mean()) < 0.01
    assert float((compiled.seen - tensors.seen).abs().mean()) < 2e-3


@pytest.mark.parametrize("name", list(RIGS))
@pytest.mark.parametrize("blur", [False, True])
def test_levels_of_canonical_colours(both: Numbers, name: str, blur: bool) -> None:
    pyramid = RigPyramid(RIGS[name][0], 256, None, "cpu")
    compiled, tensors = both(lambda: CanonicalColors(pyramid).level(128, 0.4, blur).colors)
    shown = tensors[3] > 0
    assert torch.equal(compiled[3], tensors[3])
    torch.testing.assert_close(compiled[:3, shown], tensors[:3, shown], atol=1e-4, rtol=0)


def test_colours_are_equalized(both: Numbers) -> None:
    rng = torch.Generator().manual_seed(0)
    # Not halfway between two levels: which of them that becomes is a matter of the last bit.
    colors = (
        torch.randint(0, 256, (3, 500, 3), generator=rng) + 0.8 * torch.rand((3, 500, 3), generator=rng) - 0.4
    ) / 255
    weights = (torch.rand((3, 500), generator=rng) - 0.2).clamp_min(0)
    weights[2] = 0
    compiled, tensors = both(lambda: equalize(colors, weights))
    torch.testing.assert_close(compiled, tensors, atol=1e-5, rtol=0)


@pytest.mark.parametrize("window", [SphereWindow(64, 0, 0, 64, 128), SphereWindow(64, 16, 40, 24, 48)])
def test_local_contrast(both: Numbers, window: SphereWindow) -> None:
    rng = torch.Generator().manual_seed(0)
    colors = torch.rand((2, window.height, window.width, 3), generator=rng)
    valid = (torch.rand(colors.shape[:3], generator=rng) > 0.2).float()
    compiled, tensors = both(lambda: local_contrast(colors, valid, window))
    torch.testing.assert_close(compiled, tensors, atol=1e-4, rtol=0)


@pytest.mark.parametrize("window", [SphereWindow(64, 0, 0, 64, 128), SphereWindow(64, 16, 40, 24, 48)])
@pytest.mark.parametrize("patch_deg", [45.0, 20.0])  # of 16 pixels, and of 7
def test_how_well_images_agree(both: Callable[..., Any], window: SphereWindow, patch_deg: float) -> None:
    rng = torch.Generator().manual_seed(0)
    scan, noise = (torch.rand((3, window.height * window.width, 3), generator=rng) for _ in range(2))
    shape = (3, window.height, window.width)
    empty = torch.zeros(shape)
    views = SyntheticViews(
        torch.zeros((*shape, 3)), empty, empty > 0, empty.long(), window, torch.eye(3).expand(3, 3, 3)
    )
    weights = (torch.rand(scan.shape[:2], generator=rng) - 0.2).clamp_min(0)
    weights[1, : weights.shape[1] // 3] = 0
    weights[2] = 0
    seen = torch.lerp(scan, noise, torch.rand(scan.shape[1], generator=rng)[None, :, None])
    comparison = Comparison(scan, seen, weights, None, views, torch.zeros(weights.shape, dtype=torch.int64))
    compiled, tensors = both(lambda: agreement(comparison, CONFIG.judge, 0.7, patch_deg))
    assert 0.3 < float(tensors.patch_correlation[0]) < 0.9
    for name in ("correlation", "patch_correlation", "coverage", "relative_coverage", "explained", "score"):
        torch.testing.assert_close(getattr(compiled, name), getattr(tensors, name), atol=1e-4, rtol=1e-4)


def test_what_edges_say_of_rotations(both: Numbers) -> None:
    edges = edges_of_photos(RigPyramid(RIGS["one photo"][0], 512, None, "cpu"), 512, CONFIG.lines)
    assert len(edges.normals) > 100
    compiled, tensors = both(lambda: LineSupport(edges, CONFIG.lines).of_rotations(uniform_rotations(500)))
    assert float(tensors.max()) > 0.1
    torch.testing.assert_close(compiled, tensors, atol=1e-4, rtol=0)


@pytest.mark.parametrize("name", ["panorama", "one photo"])
def test_scores_of_maps(both: Numbers, name: str) -> None:
    rig = PreparedRig(RIGS[name][0], None, torch.device("cpu"), CONFIG)
    maps = [retrieval_vectors(map_of(box)) for box in (BOX, OTHER_BOX)]
    turn = rotation_from_vector(torch.tensor([0.0, 0.0, 0.3]))
    steps, scale, levels = maps[0].steps[:-7], maps[0].scale[:-7], maps[0].levels[..., :-7].contiguous()
    maps.append(RetrievalVectors(steps, scale, levels, maps[0].axes @ turn))
    walls = rig.lines.best_axes(CONFIG.search.line_rotations, 0.0)
    compiled, tensors = both(lambda: scores_of_maps(rig.described, walls, maps, None, rig.is_wide, CONFIG.search))
    assert float(tensors.min()) > 0.1
    torch.testing.assert_close(compiled, tensors, atol=1e-5, rtol=1e-4)


def test_photos_on_the_sphere(both: Callable[..., tuple[PhotoOnWindow, PhotoOnWindow]]) -> None:
    photo = photo_of(SIDEWAYS)
    photo.valid[40:60, 100:200] = False
    compiled, arrays = both(lambda: photo_on_window(photo, 256, is_labels=False))
    assert np.array_equal(compiled.seen, arrays.seen)
    assert 0 < int(compiled.seen.sum()) < compiled.seen.size
    # What is not seen is no colour of the photo.
    assert int(np.abs(compiled.color.astype(int) - arrays.color).max()) <= 1


@pytest.mark.parametrize("name", ["one photo", "two photos"])
@pytest.mark.parametrize("is_labels", [False, True])
def test_scores_of_poses(both: Numbers, name: str, is_labels: bool) -> None:
    pixels, views, rotations = (
        replace(query(name).rig.described.pixels, is_labels=is_labels),
        map_of(BOX).views.take(torch.arange(40)),
        uniform_rotations(30),
    )
    views.seen[:] = True  # of those that are scored together, some are seen everywhere
    views.seen[:20:3, 10:20] = False
    for found, expected in (
        both(lambda: scores_of_every_pose(pixels, views, rotations)),
        both(lambda: pixel_scores(pixels, views, rotations, torch.arange(30), torch.arange(30).flip(0))),
    ):
        # A direction on the border of two pixels may show either.
        assert float((found - expected).abs().mean()) < 1e-4
        assert float((found - expected).abs().max()) < 0.02


@pytest.mark.parametrize("name", list(RIGS))
def test_patches_of_some_poses(both: Numbers, name: str) -> None:
    views, rotations = map_of(BOX).views, uniform_rotations(60)
    patches = query(name).rig.described.patches(views.basis)
    every = both(lambda: patch_scores(patches, views.descriptors(), rotations))
    torch.testing.assert_close(*every, atol=1e-4, rtol=1e-4)
    start, rotation = torch.arange(30), torch.arange(30).flip(0)
    compiled, tensors = both(lambda: patch_scores_of(patches, views, rotations, start, rotation))
    torch.testing.assert_close(compiled, tensors, atol=1e-4, rtol=1e-4)


def test_candidates_that_move_around_their_starts(both: Numbers) -> None:
    one = query("one photo")
    found = one.search.propose(one.limits, one.search.starts(one.limits), None, 24)[0]
    compiled, tensors = both(lambda: swept(one.rig.described, one.index, found, 12, CONFIG.search).positions)
    assert float((compiled - tensors).norm(dim=1).median()) < 1e-4


@pytest.mark.parametrize("is_grouped", [False, True])
def test_poses_that_are_different_ones(both: Callable[..., tuple[list[int], list[int]]], is_grouped: bool) -> None:
    rng = torch.Generator().manual_seed(0)
    rotations = uniform_rotations(576)[torch.randint(0, 576, (400,), generator=rng)]
    positions = 2 * torch.rand((400, 3), generator=rng)
    groups = torch.randint(0, 3, (400,), generator=rng) if is_grouped else None
    for count in (None, 7):
        compiled, tensors = both(lambda count=count: first_distinct(rotations, positions, NEAR, groups, count))
        assert compiled == tensors
        assert 1 < len(compiled) < 400


@pytest.fixture
def threads_as_before() -> Iterator[None]:
    before, of_tensors = library.num_threads(), torch.get_num_threads()
    yield
    library.use_threads(before)
    torch.set_num_threads(of_tensors)


@pytest.mark.usefixtures("threads_as_before")
def test_threads_change_nothing() -> None:
    level, points, *poses = aligned(3)
    many = replace(points.take(torch.arange(3).repeat(20)), sums=points.sums)
    turns, places = (pose.repeat(20, *[1] * (pose.dim() - 1)) for pose in poses)
    found = []
    for threads in (1, 3):
        library.use_threads(threads)
        assert library.num_threads() == threads
        found.append(patch_equations(level, many, turns, places, StepConfig(robust_scale=2.0)))
    assert torch.equal(found[0].hessian, found[1].hessian)
    assert torch.equal(found[0].hessian[:3], found[0].hessian[57:])


@pytest.mark.usefixtures("threads_as_before")
def test_kernels_that_are_called_at_once_do_not_disturb_each_other() -> None:
    library.use_threads(2)
    level, points, rotations, positions = aligned(3)
    expected = patch_equations(level, points, rotations, positions, StepConfig()).hessian
    with ThreadPoolExecutor(4) as callers:
        found = callers.map(lambda _: patch_equations(level, points, rotations, positions, StepConfig()), range(40))
        assert all(torch.equal(each.hessian, expected) for each in found)


@pytest.mark.usefixtures("threads_as_before")
@pytest.mark.parametrize("has_kernels", [True, False])
def test_tensors_get_the_threads_only_where_there_are_no_kernels(has_kernels: bool) -> None:
    with pytest.MonkeyPatch.context() as patch:
        if not has_kernels:
            patch.setattr(library, "kernels", lambda: None)
        library.use_threads(2)
        assert torch.get_num_threads() == (1 if has_kernels else 2)
        assert library.num_threads() == 2
