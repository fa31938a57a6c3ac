"""Measures what the algorithm costs, without a service."""
