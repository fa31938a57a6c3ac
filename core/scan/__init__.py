"""Readers of scan files: `panoloc.core.scan.reading.read_scan` detects the format and thins points while it reads
chunks."""
