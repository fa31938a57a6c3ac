"""Tables against values worked out by hand."""

import pytest

from panoloc.lab.evaluation.rows import Row
from panoloc.lab.evaluation.summary import calibration_of, summaries
from tests.lab.evaluation.made_rows import made_row


def _four() -> list[Row]:
    return [
        made_row(0, 0.01, 0.5, seconds=1.0),
        made_row(1, 0.04, 6.0, seconds=2.0),
        made_row(2, 0.2, 2.0, seconds=3.0, status="not_localized"),
        made_row(3, 2.0, 100.0, seconds=10.0),
    ]


def test_accuracies_need_both_errors_within_their_limits() -> None:
    (summary,) = summaries(_four(), [(0.05, 5.0), (0.3, 10.0), (5.0, 180.0)])
    assert summary.accuracies == (0.25, 0.75, 1.0)


def test_errors_are_quartiles_and_seconds_median_and_the_95th_percentile_measured() -> None:
    (summary,) = summaries(_four())
    assert summary.position_error_m is not None
    assert summary.position_error_m.median == pytest.approx(0.12)
    assert summary.position_error_m.lower == pytest.approx(0.0325)
    assert summary.position_error_m.upper == pytest.approx(0.65)
    assert (summary.seconds_median, summary.seconds_p95) == (2.5, 10.0)


def test_an_answer_far_off_counts_as_wrong_only_when_called_localized() -> None:
    rows = _four()
    (summary,) = summaries(rows)
    assert (summary.answered, summary.wrong_answers) == (0.75, 0.25)
    (cautious,) = summaries([*rows[:3], made_row(3, 2.0, 100.0, status="not_localized")])
    assert cautious.wrong_answers == 0.0


def test_strangers_are_counted_apart_from_the_accuracies() -> None:
    strangers = [
        made_row(0, None, scan="rooms-9", cross=True, status=status) for status in ("localized", "not_localized")
    ]
    unanswered = made_row(1, None, status="not_localized", confidence=None)
    (summary,) = summaries([made_row(0), *strangers, unanswered])
    assert summary.position_error_m is not None
    assert summary.position_error_m.upper == pytest.approx(0.01)  # a missing pose has no error and is within no limit
    assert (summary.num_queries, summary.strangers, summary.strangers_localized) == (2, 2, 1)
    assert summary.accuracies[0] == 0.5


def test_methods_stand_side_by_side_and_several_groups_have_a_line_for_all() -> None:
    rows = [made_row(n, group=group, method=method) for n in (0, 1) for group in ("a", "b") for method in ("m", "n")]
    found = [(one.group, one.method, one.num_queries) for one in summaries(rows)]
    assert found == [("a", "m", 2), ("a", "n", 2), ("b", "m", 2), ("b", "n", 2), ("all", "m", 4), ("all", "n", 4)]


def test_calibration_counts_strangers_as_wrong() -> None:
    rows = [made_row(0, confidence=0.9), made_row(1, None, cross=True, confidence=0.9)]
    found = calibration_of(rows)
    assert found.calibration_error == pytest.approx(0.4)
    assert found.area_under_roc == pytest.approx(0.5)


def test_radii_are_judged_on_right_poses_that_have_one() -> None:
    rows = [
        made_row(0, 0.01, accuracy_position_m=0.02, accuracy_orientation_deg=0.05),
        made_row(1, 0.03, accuracy_position_m=0.02, accuracy_orientation_deg=0.2),
        made_row(2, 3.0, accuracy_position_m=9.0, accuracy_orientation_deg=0.2),
        made_row(3, 0.01),
    ]
    found = calibration_of(rows)
    assert (found.radius_holds_position, found.radius_holds_orientation) == (0.5, 0.5)
