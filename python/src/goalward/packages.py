"""Optional packages that only some features need, imported on first use."""

import importlib
from typing import Any

from goalward.error import Error


def optional(module: str, extra: str) -> Any:
    """Import a module that an extra of this package installs.

    Raises:
        Error: if the module is not installed; the text has the command that installs it.
    """
    try:
        return importlib.import_module(module)
    except ImportError as missing:
        found = f"expected the package {module}, found none ({missing})"
        raise Error(f"{found}: pip install 'goalward[{extra}]'") from missing
