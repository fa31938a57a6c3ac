"""Formats of geographic systems: ArcGIS, STAC, GeoJSON, GPano; all need a map with a georeference."""
