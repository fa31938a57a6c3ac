"""glTF 2.0: GLB files, and JSON with its buffers and images inside or beside it."""
