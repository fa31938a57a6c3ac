"""Procedural scenes with exact poses, for the demo, the tests and the benchmarks."""
