"""Measures what everything costs, from stages of a query to queries over HTTP.

`core_parts` and what it imports need torch, numpy and the standard library alone, so that they run on any machine with a GPU.
"""
