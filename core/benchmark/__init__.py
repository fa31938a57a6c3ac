"""Measures what the algorithm costs. Torch, numpy and the standard library alone, so that it runs on any machine with a GPU."""
