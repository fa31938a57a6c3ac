"""Colours: what is left of them when the light is taken out, and gain and offset where it stays in."""
