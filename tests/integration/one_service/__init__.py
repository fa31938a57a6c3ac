"""Tests that share one running service, which ends with the last of them."""
