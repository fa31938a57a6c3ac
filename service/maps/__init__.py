"""Registered maps on the HTTP side: what is known of them, which of them a query is about, and their registration."""
