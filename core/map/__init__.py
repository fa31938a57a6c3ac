"""Registration: from a point cloud to the map index that queries are answered from."""
