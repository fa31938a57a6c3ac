"""PLY, ascii and binary, point clouds and meshes."""
