"""The sandbox: a process of its own for a reader. One that crashes or takes too much fails its scan and nothing else."""
