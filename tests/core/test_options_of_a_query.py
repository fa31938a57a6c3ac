"""Options and deadlines of a query that cannot be served."""

import pytest

from panoloc.core.errors import DeadlineExceededError, OptionsError
from panoloc.core.index.map_index import MapIndex
from panoloc.core.localizer import Localizer
from panoloc.core.panorama.panorama import Panorama


def test_a_deadline_that_has_passed_raises(localizer: Localizer, box_index: MapIndex, box_panorama: Panorama) -> None:
    for timeout_s in (0.0, 0.05):
        with pytest.raises(DeadlineExceededError):
            localizer.localize(box_panorama, [box_index], timeout_s=timeout_s)


@pytest.mark.parametrize("options", [{"top_k": 0}, {"top_k": 33}, {"method": "slow"}])
def test_options_out_of_range_are_refused(
    localizer: Localizer, box_index: MapIndex, box_panorama: Panorama, options: dict[str, object]
) -> None:
    with pytest.raises(OptionsError, match=next(iter(options))):
        localizer.localize(box_panorama, [box_index], **options)  # type: ignore[arg-type]


def test_no_map_at_all_is_refused(localizer: Localizer, box_panorama: Panorama) -> None:
    with pytest.raises(OptionsError, match="maps"):
        localizer.localize(box_panorama, [])
