"""Reports of what changed: for people (HTML, PDF), spreadsheets (CSV), maps (GeoJSON) and building models (BCF)."""
