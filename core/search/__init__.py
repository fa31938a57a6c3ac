"""All starts with all rotations: scores of poses, the candidates among them, and the hints that narrow both."""
