"""Files and folders that are written completely or not at all."""

import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from goalward.error import Error, expecting


@contextmanager
def new_file(path: Path, *, overwrite: bool) -> Iterator[BinaryIO]:
    """Open a temporary file beside `path`; it is renamed to `path` if the block ends without an error.

    Raises:
        Error: if `path` exists and `overwrite` is false, or writing fails; no temporary file is left then.
    """
    require_absent(path, overwrite=overwrite)
    temporary = _beside(path)
    try:
        with expecting(f"{path}: expected to write the file", OSError):
            with temporary.open("xb") as file:
                yield file
                file.flush()
                os.fsync(file.fileno())
            temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """Make a temporary folder beside `path`; it is renamed to `path` if the block ends without an error.

    Raises:
        Error: if `path` exists, or writing fails; no temporary folder is left then.
    """
    if path.exists():
        raise Error(f"{path}: expected no such file or folder, found one")
    temporary = _beside(path)
    try:
        with expecting(f"{path}: expected to write the folder", OSError):
            temporary.mkdir()
            yield temporary
            temporary.rename(path)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def require_absent(path: Path, *, overwrite: bool) -> None:
    """Refuse a path that exists, unless it may be overwritten.

    Raises:
        Error: if it exists and `overwrite` is false.
    """
    if path.exists() and not overwrite:
        raise Error(f"{path}: expected no such file or folder, found one; overwrite replaces a file")


def _beside(path: Path) -> Path:
    return path.with_name(f".{path.name}.{secrets.token_hex(4)}")
