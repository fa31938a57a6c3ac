"""The parts of the benchmark that need a running service."""
