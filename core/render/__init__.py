"""The scan as seen from a position: synthetic views, and their comparison with the panorama."""
