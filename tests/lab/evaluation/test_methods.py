"""Methods by name, their ablations and variants."""

import pytest

from panoloc.core.config import LocalizerConfig, PaperConfig
from panoloc.core.errors import OptionsError
from panoloc.lab.evaluation.methods import METHOD_NAMES, compared_method


def test_methods_have_different_digests() -> None:
    assert len({compared_method(name).digest for name in METHOD_NAMES}) == len(METHOD_NAMES)


def test_a_variant_changes_the_named_fields_alone() -> None:
    variant = compared_method("six=fast:search.num_candidates=6,focal.bounds=(-0.2, 0.4)")
    assert (variant.name, variant.method) == ("six", "fast")
    assert variant.config.search.num_candidates == 6
    assert variant.config.focal.bounds == (-0.2, 0.4)
    assert variant.config.paper == PaperConfig()
    assert variant.config.judge == LocalizerConfig().judge


def test_the_papers_configuration_does_not_change_the_digest_of_fast() -> None:
    assert compared_method("x=fast:paper.iterations=5").digest == compared_method("fast").digest
    assert compared_method("x=paper:paper.iterations=5").digest != compared_method("paper").digest


@pytest.mark.parametrize(
    "text",
    ["slow", "x=slow:search.num_candidates=4", "x=fast", "x=fast:nowhere.no=4", "x=fast:search.num_candidates=many"],
)
def test_anything_else_is_refused(text: str) -> None:
    with pytest.raises(OptionsError, match="method: expected"):
        compared_method(text)
