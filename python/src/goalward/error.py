"""The one exception of the package."""


class Error(ValueError):
    """Input that cannot be used. Its text is one line: what was expected, what was found, and where."""
