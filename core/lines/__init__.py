"""Straight lines: how edges of photos, and walls of maps, say how a camera is turned."""
