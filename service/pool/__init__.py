"""Worker pools: processes on this machine, or a Ray cluster behind one process that speaks for it."""
