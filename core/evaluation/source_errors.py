"""What can go wrong with cases on disk."""

from core.errors import CoreError


class SourceError(CoreError):
    """Cases are not where they were expected, or not in the expected form. The message names the file and the form."""
