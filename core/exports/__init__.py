"""Exports: placed photos as files of other systems. `formats.export` is the entry; each format is a pure function."""
