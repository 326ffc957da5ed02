"""The exception of the package, and the conversion of other packages' exceptions."""

from collections.abc import Iterator
from contextlib import contextmanager


class Error(ValueError):
    """Input that cannot be used. Its text is one line: what was expected, what was found, and where."""


@contextmanager
def expecting(expected: str, *causes: type[Exception]) -> Iterator[None]:
    """Raise an `Error` in place of the exceptions that a library raises for input that it cannot use.

    Args:
        expected: the beginning of the error's text: where, and what was expected.
        causes: the exceptions that are converted.

    Raises:
        Error: if one of the causes is raised; its text is `expected`, then the text of the cause.
    """
    try:
        yield
    except Error:
        raise
    except causes as cause:
        raise Error(f"{expected}, found {one_line(cause) or type(cause).__name__}") from cause


def one_line(words: object) -> str:
    """Return a text, or the text of an exception, without line breaks."""
    return " ".join(str(words).split())
