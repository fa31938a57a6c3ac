"""Words of which programs know the reason."""

import pickle

from panoloc.core.remarks import Remark


def test_it_is_its_words_and_keeps_its_reason_on_the_way_to_another_process() -> None:
    remark = pickle.loads(pickle.dumps(Remark("turn_more", "turn")))
    assert remark == "turn"
    assert remark.reason == "turn_more"
