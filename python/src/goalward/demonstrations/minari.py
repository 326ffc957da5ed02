"""Minari data sets, in HDF5 and in Arrow.

Keys have the names that Goalward gives to the parts of a Gymnasium observation: `observation` for a space
without parts, `achieved_goal` or `arm/joints` for the entries of a Dict, `0` for those of a Tuple. A Discrete
observation becomes one-hot. The key of actions is `actions`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from goalward.demonstrations.recordings import Array, Recording, Wanted, is_numeric
from goalward.error import Error, expecting
from goalward.packages import optional

SUCCESS = ("infos/success", "infos/is_success")
WHOLE, ACTIONS = "observation", "actions"


def recordings(source: Path, wanted: Wanted) -> Iterator[Recording]:
    """Read the episodes of a data set.

    Args:
        source: the folder of the data set, such as `~/.minari/datasets/D4RL/door/human-v2`, or its `data`.
        wanted: whether actions are wanted; the spaces determine all keys.

    Raises:
        Error: if the data set is damaged, its actions do not fit their space, or minari is not installed.
    """
    for episode, observed, acted in _episodes(source):
        yield _recording(episode, observed, acted, wanted)


def _episodes(source: Path) -> Iterator[tuple[Any, Any, Any]]:
    """Yield the episodes as Minari reads them, each with the spaces of observations and actions."""
    minari = optional("minari", "minari")
    storage = "expected the packages of Minari's storage (pip install 'goalward[minari]')"
    # For damage, Minari raises whatever its storage packages raise.
    damage = expecting(f"{source}: expected a Minari data set", Exception)
    with damage, expecting(storage, ImportError):
        data = minari.MinariDataset(source / "data" if (source / "data").is_dir() else source)
        for episode in data.iterate_episodes():
            yield episode, data.observation_space, data.action_space


def _recording(episode: Any, observed: Any, acted: Any, wanted: Wanted) -> Recording:
    signals = {f"infos/{key}": array for key, array in _leaves(episode.infos or {})}
    signals |= {"terminations": episode.terminations, "rewards": episode.rewards}
    numeric = {key: np.asarray(array) for key, array in signals.items() if is_numeric(np.asarray(array))}
    observations = dict(_parts(observed, episode.observations, ""))
    with expecting(f"episode {episode.id}: {ACTIONS}: expected those of the action space", ValueError):
        actions = _actions(acted, episode.actions) if wanted.actions else {}
    return Recording(str(episode.id), observations, numeric, actions)


def _actions(space: Any, values: Any) -> dict[str, Array]:
    """Return actions in Goalward's measure: numbers from -1 to 1 over the bounds of a Box, choices from 0."""
    spaces = optional("gymnasium", "minari").spaces
    if isinstance(space, spaces.Discrete):
        return {ACTIONS: np.asarray(values) - int(space.start)}
    if isinstance(space, spaces.Box) and space.is_bounded():
        from goalward.spaces import actions_of

        # All rows are one action of a space with the bounds of each.
        rows = optional("gymnasium.vector.utils", "minari").batch_space(space, len(values))
        numbers = np.frombuffer(actions_of(rows).encode(values), "<f4")
        return {ACTIONS: numbers.reshape(len(values), int(np.prod(space.shape)))}
    raise Error(f"{ACTIONS}: expected a Discrete or a bounded Box space, found {space}")


def _leaves(tree: Mapping[str, Any], path: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in tree.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{path}{key}/")
        else:
            yield f"{path}{key}", value


def _parts(space: Any, values: Any, path: str) -> Iterator[tuple[str, Array]]:
    """Yield the parts of observations with their names, in the order of the space."""
    spaces = optional("gymnasium", "minari").spaces
    name = path or WHOLE
    if isinstance(space, (spaces.Dict, spaces.Tuple)):
        entries = space.spaces.items() if isinstance(space, spaces.Dict) else enumerate(space.spaces)
        for key, inner in entries:
            yield from _parts(inner, values[key], f"{path}/{key}" if path else str(key))
    elif isinstance(space, (spaces.Box, spaces.MultiBinary)):
        yield name, np.asarray(values)
    elif isinstance(space, spaces.Discrete):
        yield name, _one_hot(values, int(space.n), int(space.start), name)
    elif isinstance(space, spaces.MultiDiscrete):
        columns = np.asarray(values).reshape(-1, space.nvec.size)
        starts = space.start.reshape(-1)
        for index, (count, start) in enumerate(zip(space.nvec.reshape(-1), starts, strict=True)):
            yield f"{name}/{index}", _one_hot(columns[:, index], int(count), int(start), f"{name}/{index}")


def _one_hot(values: Any, count: int, start: int, name: str) -> Array:
    choices = np.asarray(values).reshape(-1) - start
    if ((choices < 0) | (choices >= count)).any():
        found = f"{choices.min() + start} to {choices.max() + start}"
        raise Error(f"{name}: expected {start} to {start + count - 1}, found {found}")
    hot: Array = np.eye(count, dtype=np.float32)[choices]
    return hot
