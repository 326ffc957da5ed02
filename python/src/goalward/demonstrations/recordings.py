"""`Recording`: what every source format makes of an episode before anything is chosen of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


@dataclass(frozen=True)
class Wanted:
    """What is asked for of a data set, for formats that read no more than that, or have to know it.

    Attributes:
        keys: observation keys; None for all.
        signal: the key that tells success; None if none was named.
    """

    keys: Sequence[str] | None = None
    signal: str | None = None


@dataclass(frozen=True, eq=False)
class Recording:
    """One episode of a data set. N observations are the states before, between and after N - 1 steps.

    Attributes:
        name: what the data set calls the episode, for messages.
        observations: arrays with N rows by key, in the data set's order.
        signals: what may tell success, by key: N values, one for each observation; N - 1, one for each
            step; or a single one for the episode.
    """

    name: str
    observations: Mapping[str, Array]
    signals: Mapping[str, Array] = field(default_factory=dict)


def of_states(signal: Array) -> Array:
    """Values of N steps as those of N observations, where the one after the last step was not recorded.

    What holds after step i holds for observation i + 1. What holds after the last step counts for the last
    observation there is.

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
    """Whether an array holds numbers or booleans."""
    return array.dtype.kind in "biuf"
