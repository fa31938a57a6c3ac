"""Wavefront OBJ with its materials and textures."""
