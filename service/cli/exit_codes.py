"""The exit codes of `panoloc`, documented in docs/cli.md and kept stable for scripts."""

from enum import IntEnum


class ExitCode(IntEnum):
    """What a finished command says to the shell."""

    OK = 0
    ERROR = 1
    USAGE = 2
    NOT_LOCALIZED = 3
    AMBIGUOUS = 4
    UNREACHABLE = 5
    INTERRUPTED = 130


_OF_STATUS = {
    "localized": ExitCode.OK,
    "ambiguous": ExitCode.AMBIGUOUS,
    "not_localized": ExitCode.NOT_LOCALIZED,
}
# For several panoramas the first of these that occurred is reported.
_WORST_FIRST = (ExitCode.ERROR, ExitCode.NOT_LOCALIZED, ExitCode.AMBIGUOUS)


def exit_code_of(status: str) -> ExitCode:
    """Return the exit code for the `status` of one answer."""
    return _OF_STATUS.get(status, ExitCode.ERROR)


def worst_of(codes: list[ExitCode]) -> ExitCode:
    """Return the exit code for several panoramas: the worst of theirs."""
    return next((code for code in _WORST_FIRST if code in codes), ExitCode.OK)
