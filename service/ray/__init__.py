"""The worker pool on Ray."""
