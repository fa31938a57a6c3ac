"""Pages that open a tour in the viewer it is written for.

They need a web server, because browsers give pages of a folder no other files. Photo Sphere Viewer and Pannellum come from
a public mirror of npm, in a version and with digests that the page names; Potree from the folder in which somebody has built it.
"""

import html

from panoloc.core.exports.tour import ExportedFile

_MIRROR = "https://cdn.jsdelivr.net/npm"
_PSV, _THREE, _PANNELLUM = "@photo-sphere-viewer", "three@0.185.1/build", "pannellum@2.5.7/build"
_PSV_CORE, _PSV_TOUR = f"{_PSV}/core@5.15.1", f"{_PSV}/virtual-tour-plugin@5.15.1"
DIGESTS: dict[str, str] = {
    f"{_PSV_CORE}/index.module.js": "hZQgapgsS+zAk2AwifABW1X8MfLIb43CN5l3MxVMHYiTMy7yHpaEp3AtbbhMpHkO",
    f"{_PSV_CORE}/index.css": "MUDeJzy/kC226Woqun+4AUOuTd2QGFrYMHmm6uvnycL6knrocU41aC9R4GmCBwyn",
    f"{_PSV_TOUR}/index.module.js": "ws+xvpi08AhtmV5xvs83MnPt+6jlpJjJANK48XXR8qL4uVckr/GMoI+DrA9GPZGt",
    f"{_PSV_TOUR}/index.css": "7gZQVOzr2zBovxp9uGobzboH3GV+8bzD3rPGx3o8m4flbeXnnsx2p5+8XCjWUTfU",
    f"{_THREE}/three.module.min.js": "QHQk1LzjJlJYNdthXjKCmffpDRZL3EqJ7LfqBzyKyvGgjAYM2ZVuYtFGg42NcAJ/",
    f"{_THREE}/three.core.min.js": "rx+KIp/9ptjArhnFAcpVoOc/ynktDsRtRJKIbC7YVKylEvFu8sgmzk9RmQ+CIV48",
    f"{_PANNELLUM}/pannellum.js": "ynERiwwVeRMDw4sOcewUSlt3GqiEr7HYphSk4Hh0iDivZBoXpRf7nC6ULoJ9mSxc",
    f"{_PANNELLUM}/pannellum.css": "r9OnhfpOsYbUcBsiA2HDe+U8gpr4hjc6k0a3ClCY7/U6QYh+MugK4+LiX0fHWFpH",
}
"""SHA-384 of each file on the mirror, by its path there."""

_FRAME = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
{head}
<style>
html, body, #viewer {{ margin: 0; height: 100%; font: 16px/1.5 system-ui, sans-serif; }}
#note {{ position: absolute; z-index: 1; margin: 1em; max-width: 40em; }}
#photos {{ position: absolute; z-index: 100; top: 8px; right: 8px; max-width: 60%; font: inherit; }}
</style>
</head>
<body>
<p id="note">This page needs a web server and, for its viewer, the internet: run <code>python3 -m http.server</code> in this folder and open
http://localhost:8000/.</p>
<select id="photos" aria-label="Photo" hidden></select>
<div id="viewer"></div>
{script}
</body>
</html>
"""
_PHOTOS = """
const photos = document.getElementById("photos");
function offer(names, show) {
  for (const [id, name] of names) photos.add(new Option(name, id));
  photos.onchange = () => show(photos.value);
  photos.hidden = false;
  document.getElementById("note").remove();
}"""


def psv_page(title: str) -> ExportedFile:
    """Return `index.html` for `tour.json`."""
    modules = {"three": f"{_THREE}/three.module.min.js"}
    modules |= {f"{_PSV}/core": f"{_PSV_CORE}/index.module.js"}
    modules |= {f"{_PSV}/virtual-tour-plugin": f"{_PSV_TOUR}/index.module.js"}
    imports = ",\n ".join(f'"{name}": "{_MIRROR}/{path}"' for name, path in modules.items())
    scripts = (path for path in DIGESTS if path.endswith(".js") and path.startswith((_PSV, _THREE)))
    digests = ",\n ".join(f'"{_MIRROR}/{path}": "sha384-{DIGESTS[path]}"' for path in scripts)
    importmap = f'<script type="importmap">{{"imports": {{\n {imports}}},\n "integrity": {{\n {digests}}}}}</script>'
    head = "\n".join([_style(f"{_PSV_CORE}/index.css"), _style(f"{_PSV_TOUR}/index.css"), importmap])
    script = f"""<script type="module">
import {{ Viewer }} from "{_PSV}/core";
import {{ VirtualTourPlugin }} from "{_PSV}/virtual-tour-plugin";
{_PHOTOS}
const tour = await (await fetch("tour.json")).json();
const viewer = (window.viewer = new Viewer({{ container: "viewer", plugins: [VirtualTourPlugin.withConfig(tour.virtualTour)] }}));
const plugin = viewer.getPlugin(VirtualTourPlugin);
offer(tour.virtualTour.nodes.map((node) => [node.id, node.data.name]), (id) => plugin.setCurrentNode(id));
plugin.addEventListener("node-changed", (event) => {{ photos.value = event.node.id; }});
</script>"""
    return _page(title, head, script)


def pannellum_page(title: str) -> ExportedFile:
    """Return `index.html` for `pannellum.json`."""
    code = f"{_PANNELLUM}/pannellum.js"
    head = f'{_style(f"{_PANNELLUM}/pannellum.css")}\n<script src="{_MIRROR}/{code}" {_checked(code)}></script>'
    script = f"""<script type="module">
{_PHOTOS}
const tour = await (await fetch("pannellum.json")).json();
const viewer = (window.viewer = pannellum.viewer("viewer", {{ ...tour, escapeHTML: true }}));
let loading = true; // asked for another scene meanwhile, the viewer loads both at once or drops the second
const show = () => loading || photos.value === viewer.getScene() || viewer.loadScene(photos.value);
offer(Object.keys(tour.scenes).map((name) => [name, name]), show);
viewer.on("scenechange", (name) => {{ loading = true; photos.value = name; }});
for (const end of ["load", "error"]) viewer.on(end, () => {{ loading = false; setTimeout(show); }});
</script>"""
    return _page(title, head, script)


def potree_page(title: str) -> ExportedFile:
    """Return `index.html` for `coordinates.txt`.

    It lies two folders below a build of Potree 1.8, as Potree's own examples do, and shows `pointcloud/`, which PotreeConverter 2 makes of
    the scan, where there is one.
    """
    libraries = (
        *("jquery/jquery-3.1.1.min.js", "spectrum/spectrum.js", "jquery-ui/jquery-ui.min.js", "other/BinaryHeap.js"),
        *(
            "tween/tween.min.js",
            "d3/d3.js",
            "proj4/proj4.js",
            "openlayers3/ol.js",
            "i18next/i18next.js",
            "jstree/jstree.js",
        ),
    )
    styles = (
        "jquery-ui/jquery-ui.min.css",
        "openlayers3/ol.css",
        "spectrum/spectrum.css",
        "jstree/themes/mixed/style.css",
    )
    sheets = ("build/potree/potree.css", *(f"libs/{each}" for each in styles))
    code = (*(f"libs/{each}" for each in libraries), "build/potree/potree.js", "libs/plasio/js/laslaz.js")
    head = "\n".join(
        [f'<link rel="stylesheet" href="../../{each}">' for each in sheets]
        + [f'<script src="../../{each}"></script>' for each in code]
    )
    script = """<div class="potree_container" style="position: absolute; inset: 0">
<div id="potree_render_area"></div>
<div id="potree_sidebar_container"></div>
</div>
<script type="module">
window.viewer = new Potree.Viewer(document.getElementById("potree_render_area"));
document.getElementById("note").remove();
viewer.setPointBudget(2_000_000);
viewer.loadGUI();
if ((await fetch("pointcloud/metadata.json", { method: "HEAD" })).ok) {
  Potree.loadPointCloud("pointcloud/metadata.json", "scan", (loaded) => viewer.scene.addPointCloud(loaded.pointcloud));
}
const photos = await Potree.Images360Loader.load(".", viewer);
viewer.scene.add360Images(photos);
const [x, y, z] = photos.images[0].position;
viewer.scene.view.setView([x - 3, y - 3, z + 2], [x, y, z]);
</script>"""
    return _page(title, head, script)


def _page(title: str, head: str, script: str) -> ExportedFile:
    return ExportedFile("index.html", _FRAME.format(title=html.escape(title), head=head, script=script).encode())


def _style(path: str) -> str:
    return f'<link rel="stylesheet" href="{_MIRROR}/{path}" {_checked(path)}>'


def _checked(path: str) -> str:
    return f'integrity="sha384-{DIGESTS[path]}" crossorigin="anonymous"'
