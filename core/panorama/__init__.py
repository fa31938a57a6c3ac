"""The photo: reading it, its resolutions, and what is sampled from it."""
