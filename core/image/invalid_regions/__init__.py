"""What an image shows that is not the place: void, bars, and what cameras and stitchers put around the poles."""
