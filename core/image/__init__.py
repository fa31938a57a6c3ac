"""From the bytes of an image to the windows that it fills of spheres, at several resolutions."""
