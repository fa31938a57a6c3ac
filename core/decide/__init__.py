"""Which pose is right, how sure that is, and what has changed since the scan."""
