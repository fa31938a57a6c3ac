"""The command `panoloc`: a client of the HTTP API, and the way to start the service.

Nothing here imports torch, Ray or the algorithm before a command needs it, so that client commands start at once.
"""

from service.cli.entry import main, run

__all__ = ["main", "run"]
