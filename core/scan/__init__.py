"""Readers of scan files: `core.scan.reading.read_scan` finds the format out, streams the file in chunks and thins while it reads."""
