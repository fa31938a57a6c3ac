"""The command `panoloc`: a client of the HTTP API, and the way to start the service.

Nothing here imports torch, Ray or the algorithm before a command needs it, so that client commands start at once.
"""

import sys


def main() -> None:
    """Run the command line of this process and exit with its code; Ctrl-C ends it quietly from its first import on."""
    try:
        from panoloc.service.cli.entry import run

        sys.exit(run(sys.argv[1:]))
    except KeyboardInterrupt:
        sys.exit(130)


__all__ = ["main"]
