"""Where things are: poses, rotations, and the projection between the sphere and its equirectangular image."""
