"""The scale of continuous actions: what an environment makes of the numbers that a policy chose."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from goalward.error import Error


def scaled(numbers: NDArray[Any], setting: Mapping[str, Any]) -> NDArray[np.float32]:
    """Return continuous actions as the environment acts on them: scaled, then clipped to [-1, 1].

    Args:
        numbers: (rows, len) numbers, as a log, a file of demonstrations or a policy's distribution has them.
        setting: the environment's setting. Its key `action_scale` has `len` factors; none for a scale of one.

    Raises:
        Error: if the setting has another number of factors.
    """
    factors = np.asarray(setting.get("action_scale") or [1.0] * numbers.shape[1], np.float32)
    if factors.shape != numbers.shape[1:]:
        raise Error(f"action_scale: expected {numbers.shape[1]} factors, found {factors.size}")
    return np.clip(numbers * factors, -1.0, 1.0).astype(np.float32)
