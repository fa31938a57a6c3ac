"""Locks and change signals among the API replicas on one storage."""
