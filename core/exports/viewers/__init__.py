"""Formats of viewers that show photos in place: Potree, NavVis, Photo Sphere Viewer, Pannellum, glTF."""
