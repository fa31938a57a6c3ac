"""Batches: many images, each a query of its own, kept until somebody deletes them, so that a restart loses nothing."""
