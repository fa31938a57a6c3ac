"""OBJ models with their materials and textures."""
