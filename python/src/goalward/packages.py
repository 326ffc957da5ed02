"""Packages that only some formats need, imported when one of them is used."""

import importlib
from typing import Any

from goalward.error import Error


def optional(module: str, extra: str) -> Any:
    """Import a module that belongs to an extra of this package.

    Raises:
        Error: if the module is not installed; names the command that installs it.
    """
    try:
        return importlib.import_module(module)
    except ImportError as missing:
        found = f"expected the package {module}, found none ({missing})"
        raise Error(f"{found}: pip install 'goalward[{extra}]'") from missing
