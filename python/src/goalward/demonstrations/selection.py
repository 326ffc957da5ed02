"""Selection of demonstrations from recordings: which keys, up to where, and whether the goal was reached."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby, zip_longest
from typing import Literal

import numpy as np

from goalward.demonstrations.episode import Episode, checked_observations
from goalward.demonstrations.recordings import Array, Recording
from goalward.error import Error
from goalward.task import Cells, Discrete, Task

ALL = "all"


@dataclass(frozen=True)
class Selection:
    """The parts taken from every recording of a data set.

    Attributes:
        task: the demonstrated task.
        keys: observation keys in the order of the task's observation; None for all of the data set.
        success: `all`, or the key of the signal that indicates success; None for the first key of
            `known_success` that the data set has.
        known_success: the keys that indicate success by the convention of the format.
        labels: whether the parts of the observation must match the task's labels.
        actions: keys of the actions; none for states only.
    """

    task: Task
    keys: Sequence[str] | None = None
    success: str | None = None
    known_success: Sequence[str] = ()
    labels: Literal["match", "ignore"] = "match"
    actions: Sequence[str] = ()

    def episodes(self, recordings: Iterable[Recording]) -> Iterator[Episode | None]:
        """Make a demonstration from every recording.

        Yields:
            An episode that ends where it first reached the goal; None for a recording that did not reach
            it, or began there.

        Raises:
            Error: if a recording lacks a key or does not fit the task; the text names the recording.
        """
        for recording in recordings:
            success = self._success_key(recording)
            keys = self._keys(recording, success)
            yield self._episode(recording, keys, success)

    def _episode(self, recording: Recording, keys: Sequence[str], success: str) -> Episode | None:
        observations = self._joined(recording, keys)
        actions = self._acted(recording, len(observations) - 1) if self.actions else None
        if success != ALL:
            reached = _reached(recording, success, len(observations))
            if not reached.any() or reached[0]:
                return None
            observations = observations[: int(np.argmax(reached)) + 1]
        checked = checked_observations(observations, self.task, f"episode {recording.name}")
        return Episode(checked, None if actions is None else actions[: len(checked) - 1], name=recording.name)

    def _success_key(self, recording: Recording) -> str:
        if self.success is None:
            found = next((key for key in self.known_success if key in recording.signals), None)
            if found is None:
                keys = ", ".join(recording.signals) or "none"
                expected = f"`{ALL}` (each episode reaches the goal at its last observation) or a key"
                raise Error(f"success: expected {expected}, found neither; possible success keys: {keys}")
            return found
        if self.success != ALL and self.success not in recording.signals:
            keys = ", ".join(recording.signals) or "none"
            expected = f"`{ALL}` or a success key ({keys})"
            raise Error(f"episode {recording.name}: success: expected {expected}, found `{self.success}`")
        return self.success

    def _keys(self, recording: Recording, success: str) -> Sequence[str]:
        found = recording.observations
        others = (success, *self.known_success, *self.actions)
        keys = self.keys or [key for key in found if key not in others]
        missing = next((key for key in keys if key not in found), None)
        where = f"episode {recording.name}: keys"
        if missing is not None:
            raise Error(f"{where}: expected `{missing}`, found {_listed(found)}")
        expected = int(np.prod(self.task.observation.shape))
        if sum(_width(found[key]) for key in keys) != expected:
            own = {key: found[key] for key in keys}
            wanted = f"{expected} numbers, the observation of {self.task.name}"
            fitting = [key for key, array in found.items() if _width(array) == expected]
            hint = f"; --keys {fitting[0]} fits" if len(fitting) == 1 else ""
            raise Error(f"{where}: expected {wanted}, found {_listed(own)}{hint}")
        if self.labels == "match" and len(keys) > 1 and self.task.labels:
            _require_labels(self.task.labels, [(key, _width(found[key])) for key in keys])
        return keys

    def _joined(self, recording: Recording, keys: Sequence[str]) -> Array:
        arrays = [recording.observations[key] for key in keys]
        rows = {key: len(array) for key, array in zip(keys, arrays, strict=True)}
        if len(set(rows.values())) > 1:
            found = ", ".join(f"{key} ({count})" for key, count in rows.items())
            raise Error(f"episode {recording.name}: expected keys with as many rows, found {found}")
        if isinstance(self.task.observation, Cells) and len(arrays) == 1 and arrays[0].ndim > 1:
            return arrays[0]
        return np.concatenate([array.reshape(len(array), _width(array)) for array in arrays], axis=1)

    def _acted(self, recording: Recording, steps: int) -> Array:
        """Return the actions of `steps` steps: choices, or rows of numbers."""
        where = f"episode {recording.name}: actions"
        columns = []
        for key in self.actions:
            if key not in recording.actions:
                raise Error(f"{where}: expected `{key}`, found {_listed(recording.actions)}")
            array = recording.actions[key]
            if len(array) not in (steps, steps + 1):
                expected = f"{steps} rows of `{key}`, one for each step, or one more"
                raise Error(f"{where}: expected {expected}, found {len(array)}")
            columns.append(array[:steps].reshape(steps, _width(array)))
        joined = np.concatenate(columns, axis=1)
        return joined[:, 0] if isinstance(self.task.action, Discrete) and joined.shape[1] == 1 else joined


def _reached(recording: Recording, key: str, observations: int) -> Array:
    """Return for each observation whether the goal is reached."""
    signal = np.asarray(recording.signals[key]).reshape(-1)
    where = f"episode {recording.name}: {key}"
    told = np.isin(signal, (0, 1))
    if not told.all():
        found = signal[~told][0]
        raise Error(f"{where}: expected 0 and 1, found {found}; choose another key of success or `{ALL}`")
    reached = signal.astype(bool)
    if len(reached) == observations:
        return reached
    if len(reached) == observations - 1:
        return np.concatenate([[False], reached])
    if len(reached) == 1:
        return np.repeat([False, bool(reached[0])], [observations - 1, 1])
    expected = f"{observations} values, one for each observation, one fewer, or a single one"
    raise Error(f"{where}: expected {expected}, found {len(reached)}")


def _require_labels(labels: Sequence[str], parts: Sequence[tuple[str, int]]) -> None:
    """Refuse parts whose name, length or order differs from those that the task's labels name.

    Single numbers with the names of the labels fit, too: columns `place[0]` and `place[1]` of a table.
    """
    if parts == [(label, 1) for label in labels]:
        return
    names = (re.sub(r"\[\d+\]$", "", label) for label in labels)
    expected = [(name, len(list(group))) for name, group in groupby(names)]
    for number, (wanted, found) in enumerate(zip_longest(expected, parts), 1):
        if wanted != found:
            words = [f"{part[0]} ({part[1]})" if part else "none" for part in (wanted, found)]
            remedy = "other keys, or labels=ignore"
            raise Error(f"labels: part {number}: expected {words[0]}, found {words[1]}; choose {remedy}")


def _width(array: Array) -> int:
    return int(np.prod(array.shape[1:]))


def _listed(arrays: Mapping[str, Array]) -> str:
    return ", ".join(f"{key} ({_width(array)})" for key, array in arrays.items()) or "none"
