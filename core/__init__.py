"""The algorithm of panoloc: torch, numpy and C++; no HTTP, no Redis, no logging set-up, no globals.

What narrows a query is in `panoloc.core.options`, what can go wrong in `panoloc.core.errors`; neither loads torch.
"""
