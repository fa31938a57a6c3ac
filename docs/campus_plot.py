"""Plot what `panoloc evaluate campus --json` measured: seconds, memory and recall against the number of maps.

`python docs/campus_plot.py docs/campus.svg panorama=panorama.json "six frames"=frames.json`; needs matplotlib, which nothing else does.
"""

import json
import sys
from pathlib import Path

import matplotlib.pyplot as plt  # type: ignore[import-not-found]

_PANELS = (("p50_s", "seconds, median"), ("vectors_mb", "memory of vectors, MB"), ("recall", "recall"))


def main(target: str, *given: str) -> None:
    """Write the plot. given: name of a kind of query, "=", and the file with its figures."""
    plt.rcParams |= {
        "svg.hashsalt": "panoloc",
        "svg.fonttype": "none",
        "font.size": 10,
        "axes.spines.top": False,
        "axes.spines.right": False,
    }
    figure, panels = plt.subplots(1, len(_PANELS), figsize=(10, 3.2), layout="constrained")
    for name, path in (one.split("=") for one in given):
        rows = json.loads(Path(path).read_text(encoding="utf-8"))["campus"]
        for panel, (key, _) in zip(panels, _PANELS, strict=True):
            panel.plot([row["maps"] for row in rows], [row[key] for row in rows], marker="o", label=name)
    for panel, (key, title) in zip(panels, _PANELS, strict=True):
        panel.set(xscale="log", xlabel="maps", title=title)
        panel.set_xticks([10, 100, 1000], ["10", "100", "1,000"])
        panel.set_yscale("linear" if key == "recall" else "log")
        panel.grid(alpha=0.3)
    panels[-1].set_ylim(0, 1.05)
    panels[0].legend(frameon=False)
    figure.savefig(target, metadata={"Date": None})


if __name__ == "__main__":
    main(*sys.argv[1:])
