"""Limits that the operator sets: of registrations, connections, and bytes in memory."""
