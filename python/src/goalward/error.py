"""The one exception of the package, and how exceptions of other packages become one."""

from collections.abc import Iterator
from contextlib import contextmanager


class Error(ValueError):
    """Input that cannot be used. Its text is one line: what was expected, what was found, and where."""


@contextmanager
def expecting(expected: str, *causes: type[Exception]) -> Iterator[None]:
    """Raise an `Error` in place of what a library raises for input that it cannot use.

    Args:
        expected: what was expected and where, as the error's text begins.
        causes: the exceptions that become an error.

    Raises:
        Error: `expected`, and what the cause says of what was found.
    """
    try:
        yield
    except Error:
        raise
    except causes as cause:
        raise Error(f"{expected}, found {one_line(cause) or type(cause).__name__}") from cause


def one_line(words: object) -> str:
    """A text, or what an exception says, without line breaks."""
    return " ".join(str(words).split())
