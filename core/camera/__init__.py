"""Cameras: which direction each pixel of a photo shows, and photos placed on the sphere."""
