"""The modules of `core` that load without numpy: all that a command may import at its start."""

FOR_COMMANDS = frozenset(
    {
        "panoloc.core",
        "panoloc.core.camera",
        "panoloc.core.camera.camera",
        "panoloc.core.remarks",
        "panoloc.core.errors",
        "panoloc.core.image",
        "panoloc.core.image.image_header",
        "panoloc.core.options",
        "panoloc.core.scan",
        "panoloc.core.scan.file_names",
        "panoloc.core.scan.zip_opening",
    }
)


def core_modules(loaded: set[str]) -> set[str]:
    """Return those of `core` among the names of modules."""
    return {name for name in loaded if name.startswith("panoloc.core.") or name == "panoloc.core"}
