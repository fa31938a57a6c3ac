"""E57, by pye57."""
