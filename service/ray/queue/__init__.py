"""Which queries wait, for how long, and in which order they go to the workers."""
