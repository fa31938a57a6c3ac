"""Formats of photogrammetry and splatting: COLMAP, OpenSfM, nerfstudio, Metashape; all with poses as cameras see them."""
