"""The modules of `core` that load without numpy: all that may be imported where a command or the HTTP process starts."""

FOR_COMMANDS = frozenset(
    {
        "core",
        "core.camera",
        "core.camera.camera",
        "core.distinct_names",
        "core.errors",
        "core.options",
        "core.panorama",
        "core.panorama.image_header",
        "core.shown_name",
        "core.zip_opening",
    }
)
FOR_THE_APPLICATION = FOR_COMMANDS - {"core.shown_name"} | {
    "core.geodesy",
    "core.geopose",
    "core.georeference",
    "core.panorama.known_camera",
    "core.scan",
    "core.scan.format_detection",
    "core.scan.ply",
    "core.scan.ply.header",
}


def core_modules(loaded: set[str]) -> set[str]:
    """Return those of `core` among the names of modules."""
    return {name for name in loaded if name.partition(".")[0] == "core"}
