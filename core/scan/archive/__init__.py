"""Zip archives: a scan with the files that it refers to, or several scans in one frame."""
