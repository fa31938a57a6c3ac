"""Readers of scan files, each returning a `core.point_cloud.PointCloud`."""
