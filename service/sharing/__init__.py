"""What several front doors (HTTP processes) on one data folder or bucket need of each other: locks, and word of what was changed."""
