"""In which order the files begin where several processes share them."""

import pytest


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Let files begin first that wait for services, then those that compute long, so that none of them is left for the end."""
    rank_of_file: dict[str, int] = {}
    for item in items:
        rank = 0 if item.get_closest_marker("integration") else 1 if item.get_closest_marker("slow") else 2
        file = _file_of(item)
        rank_of_file[file] = min(rank, rank_of_file.get(file, rank))
    items.sort(key=lambda item: rank_of_file[_file_of(item)])


def _file_of(item: pytest.Item) -> str:
    return item.nodeid.partition("::")[0]
