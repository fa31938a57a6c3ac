"""The modules of `core` that load without numpy: all that a command may import at its start."""

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


def core_modules(loaded: set[str]) -> set[str]:
    """Return those of `core` among the names of modules."""
    return {name for name in loaded if name.partition(".")[0] == "core"}
