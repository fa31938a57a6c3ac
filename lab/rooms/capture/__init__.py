"""What instruments see of a scene: panoramas, scans, and the truth about changes."""
