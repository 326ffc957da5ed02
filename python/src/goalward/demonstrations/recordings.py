"""`Recording`: the common form of an episode of any source format, before parts of it are selected."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


@dataclass(frozen=True)
class Wanted:
    """The parts wanted from a data set, for formats that read only these or need to know them.

    Attributes:
        keys: observation keys; None for all.
        signal: the key that indicates success; None if none was named.
        actions: keys of actions; none for states only.
    """

    keys: Sequence[str] | None = None
    signal: str | None = None
    actions: Sequence[str] = ()


@dataclass(frozen=True, eq=False)
class Recording:
    """One episode of a data set, with N observations: the states before, between and after N - 1 steps.

    Attributes:
        name: the episode's name in the data set, for error messages.
        observations: arrays with N rows by key, in the data set's order.
        signals: values that may indicate success, by key: N, one for each observation; N - 1, one for each
            step; or one for the episode.
        actions: arrays that may be actions, by key: N - 1 rows, one for each step; or N, the last of which
            has no state behind it.
    """

    name: str
    observations: Mapping[str, Array]
    signals: Mapping[str, Array] = field(default_factory=dict)
    actions: Mapping[str, Array] = field(default_factory=dict)


def of_states(signal: Array) -> Array:
    """Convert values of N steps to values of N observations, if the one after the last step was not recorded.

    The value of step i is that of observation i + 1. The value of the last step counts for the last recorded
    observation.

    Args:
        signal: N numbers or booleans, one for each step.

    Returns:
        N values, one for each observation.
    """
    flat = np.asarray(signal).reshape(-1)
    shifted = np.concatenate([np.zeros(1, flat.dtype), flat[:-1]])
    if len(flat) > 1:
        shifted[-1] = max(flat[-2], flat[-1])
    return shifted


def is_numeric(array: Array) -> bool:
    """Return whether an array has numbers or booleans."""
    return array.dtype.kind in "biuf"
