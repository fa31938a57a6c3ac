"""The counts of `scripts/count-engine`, on small sources whose counts are known, and the limits that the engine keeps to."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from panoloc.core.geometry.pose import Pose, pose_error
from panoloc.core.geometry.rotations import rotation_angle, rotation_from_vector
from tests.structure import engine_counts, parameter_counts, rooms
from tests.structure.query_walk import Called, Steps, Walk, traced


@dataclass(frozen=True)
class Pair:
    """Has no defaults, so that it is a value."""

    one: float
    two: float


@dataclass(frozen=True)
class Inner:
    """A section."""

    number: float = 1.0
    pair: Pair = Pair(1, 2)


@dataclass(frozen=True)
class Outer:
    """A section with the inner one twice, and with changes."""

    inner: Inner = Inner()
    again: Inner = Inner(number=2.0)
    sizes: tuple[int, int] = (1, 2)
    kept: bool = True


def test_no_query_is_asked_for_its_kind() -> None:
    files = rooms.sources("core/**/*.py", "service/worker/**/*.py")
    assert "core/localizer.py" in files
    assert engine_counts.kind_tests(files) == []


def test_beside_the_model_four_rules_at_most_decide_on_a_status() -> None:
    rules = engine_counts.status_rules(rooms.deciding_rooms())
    assert engine_counts.MODEL in rules
    assert len(rules) - 1 <= engine_counts.LIMITS["status rules"], rules


def test_every_parameter_counts_once_and_what_is_given_again_is_told() -> None:
    assert parameter_counts.parameters_of(Outer()) == ["Outer.sizes", "Outer.kept", "Inner.number", "Inner.pair"]
    assert parameter_counts.parameters_of(Outer(), known=frozenset({Inner})) == ["Outer.sizes", "Outer.kept"]
    assert parameter_counts.overridden_in(Outer()) == ["again.number"]


def test_constants_are_numbers_in_capital_letters_at_the_top_of_a_module() -> None:
    source = """
_SHARE, MOST = 0.5, 2 * 3
_BOUNDS = (1.0, 2.0)
LIMIT: float = math.radians(85)
_BY_NAME = {"pinhole": 170.0}
ALIAS = MOST
NAMES = ("a", "b")
TEXT = "3" * 3
EMPTY = Config(3)
small = 3
def function():
    INSIDE = 3
"""
    assert parameter_counts.constants_of(source) == ["_SHARE", "MOST", "_BOUNDS", "LIMIT", "_BY_NAME"]


def test_parameters_of_the_engine_are_told_from_those_of_the_paper_and_sizes_of_formats() -> None:
    found = parameter_counts.parameters()
    assert found.total == len(found.configuration) + len(found.constants) + len(found.invalid_regions)
    assert "SearchConfig.wide_share" in found.configuration
    assert not any(name.startswith("PaperConfig.") for name in found.configuration)
    assert "PaperConfig.num_starts" in found.paper
    assert any(name.startswith("core/image/invalid_regions.py") for name in found.invalid_regions)
    assert not any("exif.py" in name for name in [*found.constants, *found.invalid_regions])


def test_questions_for_the_kind_are_found_in_calls_and_in_patterns() -> None:
    source = """
if isinstance(query, Panorama) or isinstance(query, (int, camera.RigImage)) or isinstance(level, PreparedPhotos):
    pass
isinstance(error, PanoramaShapeError)
match query:
    case Rig(images):
        pass
    case Tensor():
        pass
"""
    assert engine_counts.kind_tests({"a.py": source}) == ["a.py:2", "a.py:2", "a.py:2", "a.py:6"]


def test_status_rules_are_what_sets_a_literal_status_and_the_callers_of_what_refuses_for_them() -> None:
    source = """
class Rules:
    def one(self, found):
        return self._refused(found)
    def other(self, found):
        return self._refused(found)
    def reads(self, found):
        return found.status == "localized"
    def _refused(self, found):
        return replace(found, status="not_localized")
    def _alone(self):
        return Localization("not_localized", 3)
    def copies(self, found):
        return replace(found, status=found.status, warnings=("localized",))
def model(best):
    status: Status = "localized" if best > 0.5 else "not_localized"
    return status, Rules()._alone()
"""
    assert engine_counts.status_rules({"a.py": source}) == ["a.py:model", "a.py:one", "a.py:other", "a.py:_alone"]


def test_a_return_is_a_step_into_a_room_that_was_left() -> None:
    assert Steps.through([]) == Steps(0, 0, 0)
    assert Steps.through("aabacb") == Steps(3, 1, 2)


def test_ways_count_functions_and_pairs_of_rooms_once() -> None:
    localizer, engine, step = "core/localizer.py", "core/query/engine.py", "core/refine/step.py"
    walk = Walk(
        [
            Called(None, localizer, 1),
            Called(localizer, engine, 1),
            Called(engine, step, 1),
            Called(step, step, 9),
            Called(step, engine, 7),
            Called(engine, step, 1),
            Called(engine, localizer, 5),
        ]
    )
    assert walk.of_functions() == Steps(3, 1, 2)
    assert walk.of_rooms() == Steps(3, 0, 1)
    assert walk.of_pipeline() == Steps(3, 0, 0)


def test_a_trace_holds_the_calls_of_the_engine_and_none_of_others() -> None:
    pose = Pose(np.eye(3), np.zeros(3))

    def work() -> None:
        rotation = rotation_from_vector(torch.zeros(3))
        Path("nowhere").exists()
        pose_error(pose, pose)
        rotation_angle(rotation, rotation)

    walk = traced(work)
    assert (walk.of_functions().rooms, walk.of_functions().returns) == (2, 1)
    assert walk.of_rooms() == Steps(0, 0, 0)
