"""What the groups of paths are made with."""

from functools import partial

from fastapi import APIRouter

Router = partial(APIRouter, generate_unique_id_function=lambda route: route.name)
"""A router whose operations have the names of their functions as ids."""
