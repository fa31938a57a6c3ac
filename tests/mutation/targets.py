"""What is mutated, and the quick tests that concern it: a mutant of a file is only shown to the tests named beside it.

The first pattern that fits a file counts. Tests stand in the order in which they run, the quickest first: the first one that fails
ends a mutant.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

_STORED_MAPS = (
    "tests/service/maps/test_map_registry.py",
    "tests/service/maps/test_registry_without_locks.py",
    "tests/service/http/test_changes_at_once.py",
)
_POOL = (
    "tests/service/ray/test_pool.py",
    "tests/service/ray/test_joined_pool.py",
    "tests/service/ray/test_ray_pool_loss.py",
)
_TOKENS = ("tests/service/keys/test_tokens.py", "tests/service/http/test_token_callers.py")
_STEP = ("tests/core/refine/test_gauss_newton.py", "tests/reference/test_loss_twin.py")
_INDEX = ("tests/core/index/test_map_codec.py", "tests/core/index/test_map_index.py")

# Pattern of files: files or folders of tests.
TARGETS: dict[str, tuple[str, ...]] = {
    "service/storage/folder.py": ("tests/service/storage/test_folder.py", "tests/service/storage/test_contract.py"),
    "service/cache.py": ("tests/service/test_cache.py",),
    "service/maps/registry.py": _STORED_MAPS,
    "service/keys/tokens.py": _TOKENS,
    "service/keys/signing_keys.py": _TOKENS,
    "service/keys/token_settings.py": ("tests/service/keys/test_token_settings.py",),
    "service/limits/caller_rates.py": ("tests/service/http/test_caller_rates.py",),
    "service/ray/queue/admission.py": ("tests/service/ray/queue/test_admission.py",),
    "service/ray/queue/turns.py": ("tests/service/ray/queue/test_turns.py",),
    "service/ray/map_builds.py": ("tests/service/ray/test_map_builds.py", "tests/service/ray/test_pool.py"),
    "service/ray/pool.py": _POOL,
    "core/geometry/distinct_poses.py": ("tests/core/test_distinct_poses.py",),
    "core/fast/candidate_stages.py": ("tests/core/fast/test_candidate_stages.py",),
    "core/search/lookalikes.py": ("tests/core/search/test_lookalikes.py",),
    "core/search/closer_look.py": ("tests/core/search/test_closer_look.py",),
    "core/search/pose_limits.py": ("tests/core/search/test_pose_limits.py", "tests/properties/test_hints.py"),
    "core/search/pose_scores.py": ("tests/core/search/test_pose_scores.py", "tests/reference/test_search_twin.py"),
    "core/search/map_search.py": (
        "tests/core/search/test_map_search.py",
        "tests/core/search/test_search_and_candidates.py",
    ),
    "core/search/*.py": ("tests/core/search",),
    "core/refine/gauss_newton.py": (*_STEP, "tests/core/refine/test_refinement.py"),
    "core/refine/refinement.py": ("tests/core/refine/test_stopping.py", "tests/core/refine/test_refinement.py"),
    "core/refine/candidate_points.py": (
        "tests/core/refine/test_points_seen_from_poses.py",
        "tests/core/refine/test_candidate_points.py",
    ),
    "core/refine/patch_sums.py": ("tests/core/refine/test_patch_sums.py",),
    "core/refine/*.py": ("tests/core/refine",),
    "core/judge/agreement.py": ("tests/reference/test_judge_twin.py", "tests/core/judge/test_agreement.py"),
    "core/judge/patch_correlation.py": ("tests/reference/test_judge_twin.py", "tests/core/judge/test_agreement.py"),
    "core/judge/photo_agreement.py": ("tests/core/judge/test_photo_agreement.py",),
    "core/judge/change_maps.py": ("tests/core/judge/test_change_maps.py",),
    "core/judge/confidence.py": ("tests/core/judge/test_confidence.py",),
    "core/judge/hypotheses.py": ("tests/core/judge/test_hypotheses.py",),
    "core/judge/*.py": ("tests/core/judge",),
    "core/index/map_codec.py": ("tests/properties/test_codec_packing.py", *_INDEX),
    "core/index/starts.py": ("tests/reference/test_starts_twin.py",),
    "core/index/map_diagnostics.py": ("tests/core/index/test_map_values.py",),
    "core/index/map_index.py": ("tests/core/index/test_map_values.py", "tests/core/index/test_map_index.py"),
    "core/index/map_builder.py": ("tests/core/index/test_map_builder.py", "tests/core/index/test_map_index.py"),
    "core/index/*.py": _INDEX,
}


@dataclass(frozen=True)
class Target:
    """A source file and the tests that its mutants are shown to, both relative to the top folder."""

    file: str
    tests: tuple[str, ...]


def targets() -> list[Target]:
    """Return all files that are mutated. Raises ValueError when the table names a file or a test that is not there."""
    found: dict[str, Target] = {}
    for pattern, tests in TARGETS.items():
        files = sorted(ROOT.glob(pattern))
        missing = [name for name in tests if not (ROOT / name).exists()] + ([] if files else [pattern])
        if missing:
            raise ValueError(f"tests/mutation/targets.py: expected files, got {missing}; correct the table")
        for file in _modules(files):
            found.setdefault(file, Target(file, tests))
    return sorted(found.values(), key=lambda target: target.file)


def _modules(files: list[Path]) -> Iterator[str]:
    for file in files:
        if file.name != "__init__.py":
            yield str(file.relative_to(ROOT))
