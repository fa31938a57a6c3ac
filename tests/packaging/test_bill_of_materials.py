"""`scripts/sbom` says what the service is made of."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.slow
def test_the_bill_of_materials_lists_every_locked_package_with_its_digests(tmp_path: Path) -> None:
    venv = Path(sys.prefix)
    done = subprocess.run(
        [str(ROOT / "scripts" / "sbom"), str(tmp_path), "--venv", str(venv), "--no-validate"],
        capture_output=True,
        text=True,
        timeout=280,
    )
    assert done.returncode == 0, done.stderr
    service = json.loads((tmp_path / "service.cdx.json").read_text(encoding="utf-8"))
    assert (service["bomFormat"], service["specVersion"]) == ("CycloneDX", "1.6")
    assert service["metadata"]["component"]["name"] == "panoloc"
    text = "".join((ROOT / "requirements" / f"{name}.txt").read_text(encoding="utf-8") for name in ("torch", "service"))
    locked = set(re.findall(r"^([\w.-]+)==(\S+)", text, re.MULTILINE))
    assert {(each["name"], each["version"]) for each in service["components"]} == locked
    digests = {
        digest["content"]
        for each in service["components"]
        for place in each["externalReferences"]
        for digest in place.get("hashes", [])
    }
    assert digests == set(re.findall(r"--hash=sha256:(\w+)", text))
    console = json.loads((tmp_path / "console.cdx.json").read_text(encoding="utf-8"))
    assert console["bomFormat"] == "CycloneDX"
    assert {"svelte", "three"} <= {each["name"] for each in console["components"]}
