"""When the search for photos ends: once an answer is sure enough for what was looked at by then."""

from dataclasses import replace

import pytest
import torch

from core.config import LocalizerConfig
from core.fast.fast_method import FastMethod
from core.judge.confidence import load_confidence_model
from core.judge.hypotheses import Hypothesis

pytestmark = pytest.mark.slow
CPU = torch.device("cpu")
CONFIG = LocalizerConfig()
SEARCH = replace(CONFIG.photo_search, level_candidates=5, num_candidates=6, first_portion=2, lookalikes=0)


def test_evidence_grows_with_what_speaks_for_a_pose() -> None:
    method = FastMethod(CONFIG, CPU, load_confidence_model())
    measures = {"patch_correlation": 0.3, "halves_apart_m": 0.1, "halves_apart_deg": 2.0, "lines": 0.8}
    usual = Hypothesis(0, 0, torch.eye(3), torch.zeros(3), score=0.2, measures=measures)

    def with_one(**other: float) -> float:
        return method.evidence(replace(usual, measures=measures | other))

    assert with_one(patch_correlation=0.4) > with_one() > with_one(halves_apart_m=0.3)
    assert with_one(lines=1.0) > with_one()
    assert with_one(distinctness=0.0) == with_one()  # that is of the place and the others
