"""NumPy archives: arrays with all episodes, stacked or concatenated.

Stacked arrays have the shape (episodes, N, ...). The arrays of the keys determine N; without keys, those of
three or more dimensions, because one of two dimensions may be a goal of each episode. Episodes of different
lengths are padded at the end, and `lengths` has the number of observations of each. Concatenated arrays have
the shape (rows, ...), and `episode_ends` has the row after the last one of each episode, as in replay buffers
of diffusion policies.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from goalward.arrays import require_all
from goalward.demonstrations.recordings import Array, Recording, Wanted, is_numeric
from goalward.error import Error, expecting

SUCCESS = ("success",)
ENDS, LENGTHS = "episode_ends", "lengths"


def recordings(source: Path, wanted: Wanted) -> Iterator[Recording]:
    """Read the episodes of an archive.

    Args:
        source: the `.npz` file.
        wanted: the keys, whose arrays have a row for each observation; without keys, the shapes show which
            arrays have.

    Raises:
        Error: if the file is damaged, or its arrays do not fit together.
    """
    arrays = _arrays(source)
    if not arrays:
        raise Error(f"{source}: expected arrays of numbers, found none")
    yield from _joined(source, arrays) if ENDS in arrays else _stacked(source, arrays, wanted.keys)


def _arrays(source: Path) -> dict[str, Array]:
    damage = (OSError, ValueError, EOFError, BadZipFile, NotImplementedError, zlib.error)
    with (
        expecting(f"{source}: expected a NumPy archive of arrays of numbers", *damage),
        source.open("rb") as file,
        np.load(file, allow_pickle=False) as archive,
    ):
        arrays = {name: archive[name] for name in archive.files}
    return {name: array for name, array in arrays.items() if is_numeric(array)}


def _joined(source: Path, arrays: Mapping[str, Array]) -> Iterator[Recording]:
    ends = _whole(source, ENDS, arrays[ENDS])
    rows = int(ends[-1]) if len(ends) else 0
    if (np.diff(ends, prepend=0) <= 0).any():
        raise Error(f"{source}: {ENDS}: expected rows that grow, found {ends.tolist()[:10]}")
    of_rows = {name: array for name, array in arrays.items() if array.ndim and len(array) == rows}
    if not of_rows:
        raise Error(f"{source}: expected arrays of {rows} rows, the last of `{ENDS}`, found none")
    of_episodes = _signals_of_episodes(arrays, len(ends))
    starts = np.concatenate([[0], ends[:-1]])
    for number, (start, end) in enumerate(zip(starts, ends, strict=True)):
        own = {name: array[start:end] for name, array in of_rows.items() if name not in (ENDS, *of_episodes)}
        ended = {name: array[number] for name, array in of_episodes.items()}
        yield Recording(str(number), own, _flat(own) | ended, own)


def _stacked(source: Path, arrays: Mapping[str, Array], keys: Sequence[str] | None) -> Iterator[Recording]:
    stacks = {name: array for name, array in arrays.items() if array.ndim > 1}
    if not stacks:
        raise Error(f"{source}: expected arrays (episodes, observations, ...) or `{ENDS}`, found neither")
    episodes, rows = _size(stacks, keys)
    lengths = _whole(source, LENGTHS, arrays.get(LENGTHS, np.full(episodes, rows)))
    if len(lengths) != episodes:
        raise Error(
            f"{source}: {LENGTHS}: expected {episodes} numbers, found {len(lengths)}; episodes that follow"
            f" each other in arrays (rows, ...) need `{ENDS}`, the running sum of their lengths"
        )
    wrong = np.flatnonzero((lengths < 1) | (lengths > rows))
    if len(wrong):
        where, found = f"{source}: episode {wrong[0]}: {LENGTHS}", lengths[wrong[0]]
        raise Error(f"{where}: expected a number from 1 to {rows}, found {found}")
    of_episodes = _signals_of_episodes(arrays, episodes)
    for number, length in enumerate(lengths):
        own = {name: array[number] for name, array in stacks.items() if len(array) == episodes}
        observed = {name: array[:length] for name, array in own.items() if len(array) == rows}
        # An array with one row less has a value for each step.
        steps = {name: array[: length - 1] for name, array in own.items() if len(array) == rows - 1}
        ended = {name: array[number] for name, array in of_episodes.items()}
        signals = _flat(observed) | _flat(steps) | ended
        yield Recording(str(number), observed, signals, observed | steps)


def _whole(source: Path, name: str, array: Array) -> Array:
    """Return an array's values in a row, as integers."""
    flat = array.reshape(-1)
    require_all(np.isfinite(flat) & (flat == np.floor(flat)), flat, str(source), name, "a whole number")
    return flat.astype(np.int64)


def _size(stacks: Mapping[str, Array], keys: Sequence[str] | None) -> tuple[int, int]:
    """Return the number of episodes, and of rows for the observations of one."""
    asked = [stacks[key] for key in keys or () if key in stacks]
    deep = [array for array in stacks.values() if array.ndim > 2]
    shapes = [array.shape[:2] for array in asked or deep or stacks.values()]
    episodes, rows = max(shapes, key=lambda shape: shape[1])
    # The deep ones may be the actions of observations that are single numbers.
    has_more = not asked and any(array.shape[1] == rows + 1 for array in stacks.values())
    return episodes, rows + has_more


def _signals_of_episodes(arrays: Mapping[str, Array], episodes: int) -> dict[str, Array]:
    own = {name: array for name, array in arrays.items() if name not in (ENDS, LENGTHS)}
    return {name: array for name, array in own.items() if array.shape in ((episodes,), (episodes, 1))}


def _flat(arrays: Mapping[str, Array]) -> dict[str, Array]:
    return {name: array for name, array in arrays.items() if array.size == len(array)}
