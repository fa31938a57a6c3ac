"""Textures, patterns and styles that made-up rooms are painted with."""
