"""What came, went and moved between a scan and photos with known poses, as objects."""
