"""Measures what everything costs, from the search alone to queries over HTTP.

What needs no service uses torch, numpy and the standard library alone, so that it runs on any machine with a GPU.
"""
