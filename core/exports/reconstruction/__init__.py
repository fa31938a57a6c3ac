"""Formats of photogrammetry and splatting: COLMAP, OpenSfM, nerfstudio, Metashape."""
