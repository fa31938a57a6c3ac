"""Shows errors of the algorithm where a command runs it in its own process."""

from collections.abc import Iterator
from contextlib import contextmanager

from rich.markup import escape

from panoloc.service.cli.session import Session


@contextmanager
def core_errors_shown(session: Session) -> Iterator[list[str]]:
    """Show an error of the algorithm or of a source as one message; yields the list that then holds it."""
    from panoloc.core.errors import CoreError

    failed: list[str] = []
    try:
        yield failed
    except CoreError as error:
        failed.append(str(error))
        if session.json_output:
            session.print_json({"error": {"type": type(error).__name__, "message": str(error)}})
        session.messages.print(f"[bold red]Error:[/] {escape(str(error))}")
