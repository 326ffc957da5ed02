"""robomimic data sets: an HDF5 file with a group for each demonstration.

`obs/<key>` has the state before each step. The last row of `next_obs/<key>`, if it exists, has the state
after the last step. By default, a sparse reward of 1 indicates success. `dones` does not: in most data sets
it is also 1 at the end of a demonstration that failed.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from goalward.demonstrations.recordings import Array, Recording, Wanted, is_numeric, of_states
from goalward.error import Error, expecting
from goalward.packages import optional

SUCCESS = ("rewards",)
SIGNALS = ("rewards", "dones")
MOST_DIMENSIONS = 2  # rows of numbers; images have more dimensions


def recordings(source: Path, wanted: Wanted) -> Iterator[Recording]:
    """Read the demonstrations of a file, in the order of their numbers.

    Args:
        source: the `.hdf5` file.
        wanted: the observation keys to read; without keys, all that have rows of numbers. The signal is one
            beside `obs`: a value per step, or one of the demonstration.

    Raises:
        Error: if the file is damaged or is not a robomimic data set, or h5py is not installed.
    """
    h5py = optional("h5py", "robomimic")
    causes = (OSError, KeyError, RuntimeError)  # h5py raises any of these for damage
    with expecting(f"{source}: expected an HDF5 file", *causes), h5py.File(source, "r") as file:
        demonstrations = file.get("data", {})
        if not isinstance(demonstrations, (dict, h5py.Group)):
            raise Error(f"{source}: expected a group `data` of demonstrations, found a dataset")
        for name in sorted(demonstrations, key=_number):
            yield _recording(name, demonstrations[name], wanted)


def _number(name: str) -> tuple[int, str]:
    digits = re.search(r"\d+$", name)
    return (int(digits[0]) if digits else 0, name)


def _recording(name: str, group: Any, wanted: Wanted) -> Recording:
    if "obs" not in group:
        raise Error(f"episode {name}: expected a group `obs`, found {', '.join(group)}")
    observed, following = group["obs"], group.get("next_obs", {})
    asked = [key for key in observed if wanted.keys is None or key in wanted.keys]
    rows = [key for key in asked if _has_numbers(observed[key]) and observed[key].ndim <= MOST_DIMENSIONS]
    has_last = all(key in following for key in rows)
    observations = {key: _with_last(observed[key], following[key] if has_last else None) for key in rows}
    signals = _signals(group, wanted.signal)
    if not has_last:
        signals = {key: of_states(told) if told.size > 1 else told for key, told in signals.items()}
    actions = {key: group[key][()] for key in wanted.actions if key in group and _has_numbers(group[key])}
    return Recording(name, observations, signals, actions)


def _signals(group: Any, wanted: str | None) -> dict[str, Array]:
    # Only what is beside `obs`: a path into it would be of observations, not of steps.
    found = {name: group[name] for name in group if name in (*SIGNALS, wanted)}
    return {name: member[()] for name, member in found.items() if _has_numbers(member)}


def _has_numbers(member: Any) -> bool:
    return hasattr(member, "dtype") and is_numeric(member)  # a group has no type


def _with_last(observed: Any, following: Any) -> Array:
    return observed[()] if following is None else np.concatenate([observed[()], following[-1:]])
