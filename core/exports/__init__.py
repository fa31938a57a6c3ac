"""Exports: placed photos as files of other systems; `formats.export` is the way in, one module per format, each a pure function."""
