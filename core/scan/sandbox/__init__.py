"""Readers in a process of their own: one that crashes, or takes too much memory or time, fails its scan and nothing else."""
