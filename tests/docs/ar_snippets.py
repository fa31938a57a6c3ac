"""Runs what the code in docs/ar does with a camera: its own lines, on stand-ins of what each platform hands out.

Of Swift and Kotlin only names that are bound and expressions of numbers are run, which are Python as well. For WebXR the npm package runs
as it is.
"""

import re
from types import SimpleNamespace
from typing import Any

from tests.docs.documentation import ROOT

FILES = {"ARKit": "arkit.swift", "ARCore": "arcore.kt"}
ENTRY = {
    "ARKit": "func entry(_ camera: ARCamera)",
    "ARCore": "fun entry(camera: Camera)",
}
_BINDING = re.compile(r"^\s*(?:let|val) (\w+|\(.+\)) = (.+)$")
_KEY = re.compile(r"\"(\w+)\"(?::| to) ")


def snippet(platform: str) -> str:
    """Return the code of a platform, without comments at the ends of lines."""
    code = (ROOT / "docs" / "ar" / FILES[platform]).read_text(encoding="utf-8")
    return re.sub(r" {2,}(//|#) .*$", "", code, flags=re.M)


def entry_of(platform: str, **given: Any) -> dict[str, Any]:
    """Return the entry of `cameras` that a snippet builds.

    given: by name what the lines read: `camera`, and functions of the platform.
    """
    code = snippet(platform)
    _, _, rest = code.partition(ENTRY[platform])
    bindings, _, literal = rest.partition("return ")
    # `let t = transform.columns.3` reads an element; Int makes a whole number of a CGFloat.
    names: dict[str, Any] = {"Int": int, **given}
    for line in bindings.splitlines():
        found = _BINDING.match(line)
        if found:
            _bind(names, found[1], _value(found[2], names))
    return _dictionary(literal, names)


def options_of(platform: str, cameras: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the options that a snippet sends with these cameras."""
    (line,) = [line for line in snippet(platform).splitlines() if re.search(r"\bcameras\b", line) and "frame" in line]
    _, _, literal = line.replace("mapOf(", "{").partition("frame")
    session = re.search(r"session\"?(?::| to) .\s?\"?up\"?(?::| to) \"(\w+)\"", literal)
    frame = re.search(r"^\"?(?::| to) \"(\w+)\"", literal)
    assert session is not None, line
    assert frame is not None, line
    return {"frame": frame[1], "cameras": cameras, "session": {"up": session[1]}}


def content_at(platform: str, scan: tuple[float, float, float]) -> tuple[float, float, float]:
    """Return where a snippet places what lies at (x, y, z) of the scan: coordinates of the map in its own axes."""
    call = {"ARKit": "simd_float4", "ARCore": "Pose.makeTranslation"}[platform]
    (arguments,) = re.findall(rf"{re.escape(call)}\(([xyz, -]+?)(?:, 1)?\)", snippet(platform))
    x, y, z = _value(f"({arguments})", dict(zip("xyz", scan, strict=True)))
    return x, y, z


def xyzw(values: Any) -> SimpleNamespace:
    """Return three or four numbers as an object with x, y, z (and w)."""
    return SimpleNamespace(**dict(zip("xyzw", map(float, values), strict=False)))


def _bind(names: dict[str, Any], target: str, value: Any) -> None:
    parts = re.findall(r"\w+", target)
    if target.startswith("("):
        names.update(zip(parts, value, strict=True))
    else:
        names[target] = value


def _dictionary(literal: str, names: dict[str, Any]) -> dict[str, Any]:
    """Return the first dictionary of `literal`: `[…]`, `mapOf(…)` or `{…}`, with keys like `"x":` or `"x" to`."""
    start = re.search(r"\[|mapOf\(|\{", literal)
    assert start is not None, literal
    found: dict[str, Any] = {}
    for item in _items(literal[start.end() :]):
        key = _KEY.match(item)
        assert key is not None, item
        value = item[key.end() :]
        found[key[1]] = _dictionary(value, names) if re.match(r"\[|mapOf\(|\{", value) else _value(value.strip(), names)
    return found


def _items(text: str) -> list[str]:
    """Return what stands between commas up to the bracket that closes `text`."""
    items, depth, item = [], 0, ""
    for letter in text:
        depth += (letter in "([{") - (letter in ")]}")
        if depth < 0:
            break
        if letter == "," and depth == 0:
            items.append(item.strip())
            item = ""
        else:
            item += letter
    return [each for each in (*items, item.strip()) if each]


def _value(expression: str, names: dict[str, Any]) -> Any:
    return eval(re.sub(r"\.(\d)", r"[\1]", expression), {"__builtins__": {}}, names)
