"""Places on Earth: coordinate systems, and poses in them."""
