"""Textures, patterns and styles that procedural rooms are painted with."""
