"""Files that are there as a whole or not at all."""

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from goalward.error import Error, expecting


@contextmanager
def new_file(path: Path, *, overwrite: bool) -> Iterator[BinaryIO]:
    """Write to a temporary file beside `path`, which gets its name when the block ends without an error.

    Raises:
        Error: if `path` exists and `overwrite` is false, or the disk refuses; nothing is left then.
    """
    require_absent(path, overwrite=overwrite)
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    try:
        with expecting(f"{path}: expected to write the file", OSError):
            with temporary.open("xb") as file:
                yield file
                file.flush()
                os.fsync(file.fileno())
            temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def require_absent(path: Path, *, overwrite: bool) -> None:
    """Refuse a path that exists, unless it may be overwritten.

    Raises:
        Error: if it exists and `overwrite` is false.
    """
    if path.exists() and not overwrite:
        raise Error(f"{path}: expected no such file, found one; it is replaced only with overwrite")
