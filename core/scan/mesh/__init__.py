"""Surfaces with colours and textures, sampled evenly: what the readers of meshes have in common."""
