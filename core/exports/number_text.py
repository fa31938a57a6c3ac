"""Numbers as text: as many decimals as the value needs, and no negative zero."""

TIME_DECIMALS = 6
"""Of seconds since 1970: a double holds no more."""


def plain(value: float, decimals: int = 9) -> str:
    """Return `value` without an exponent and without zeros at its end."""
    text = f"{value:.{decimals}f}"
    text = text.rstrip("0").rstrip(".") if "." in text else text
    return "0" if text == "-0" else text


def fixed(value: float, decimals: int) -> str:
    """Return `value` with exactly so many decimals."""
    text = f"{value:.{decimals}f}"
    return text.removeprefix("-") if float(text) == 0 else text
