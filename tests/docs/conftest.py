"""The painted box, for walks through the code."""

from tests.core.conftest import box, box_index, localizer

__all__ = ["box", "box_index", "localizer"]
