"""Experiments that the lab notebook tells of, each with what it takes to repeat it."""
