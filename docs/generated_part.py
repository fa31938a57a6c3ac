"""A part of a page that is written from the code, between two marks."""


def with_part(page: str, name: str, text: str) -> str:
    """Return the page with what stands between the marks of `name` replaced; raises ValueError without the marks."""
    begin, end = f"<!-- {name}: begin (scripts/update-docs writes this part) -->\n", f"<!-- {name}: end -->"
    before, found, rest = page.partition(begin)
    _, closed, after = rest.partition(end)
    if not found or not closed:
        raise ValueError(
            f"Expected the marks {begin.strip()!r} and {end!r} in the page; put them where the part belongs."
        )
    return f"{before}{begin}\n{text}\n{end}{after}"
