"""LeRobot data sets, formats v2.0, v2.1 and v3.0.

A frame has the state before an action; the state after the last action is not recorded. An episode of T
frames therefore has T observations and T - 1 steps, and `next.success` of the last frame counts for its last
observation. Videos and images are left out.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from goalward.demonstrations.recordings import Array, Recording, Wanted, is_numeric, of_states
from goalward.error import Error, expecting
from goalward.packages import optional

SUCCESS = ("next.success",)
INFO = Path("meta", "info.json")
VERSIONS = ("v2.0", "v2.1", "v3.0")
OBSERVED, FOLLOWING = "observation.", "next."
EPISODE, FRAME = "episode_index", "frame_index"
_NO_NUMBERS = ("image", "video", "string")


def recordings(source: Path, wanted: Wanted) -> Iterator[Recording]:
    """Read the episodes of a data set.

    Args:
        source: the folder of the data set, which has `meta/info.json`.
        wanted: the columns to read; without keys, all columns `observation.*` of numbers.

    Raises:
        Error: if the data set is damaged or has another version, or pyarrow is not installed.
    """
    features = _features(source)
    numeric = [name for name, feature in features.items() if feature.get("dtype") not in _NO_NUMBERS]
    observed = [
        name for name in numeric if (name in wanted.keys if wanted.keys else name.startswith(OBSERVED))
    ]
    signals = [name for name in numeric if name.startswith(FOLLOWING) or name == wanted.signal]
    columns = list(dict.fromkeys([EPISODE, FRAME, *observed, *signals, *wanted.actions]))
    for path in sorted(source.glob("data/*/*.parquet")):
        yield from _episodes(_columns(path, columns), observed, signals, wanted.actions)


def _columns(path: Path, names: Sequence[str]) -> dict[str, Array]:
    arrow, parquet = optional("pyarrow", "lerobot"), optional("pyarrow.parquet", "lerobot")
    with expecting(f"{path}: expected rows of numbers", OSError, ValueError, arrow.ArrowException):
        found = parquet.read_schema(path).names
        missing = next((name for name in names if name not in found), None)
        if missing is not None:
            raise Error(f"{path}: expected the column `{missing}`, found {', '.join(found)}")
        table = parquet.read_table(path, columns=names)
        return {name: _rows(table.column(name)) for name in names}


def _features(source: Path) -> Mapping[str, Mapping[str, Any]]:
    causes = (OSError, ValueError, KeyError, TypeError)
    with expecting(f"{source / INFO}: expected what LeRobot writes there", *causes):
        info = json.loads((source / INFO).read_text(encoding="utf-8"))
        version, features = info["codebase_version"], info["features"]
    if version not in VERSIONS:
        raise Error(f"{source / INFO}: expected version {', '.join(VERSIONS)}, found {version}")
    if not isinstance(features, dict) or not all(isinstance(feature, dict) for feature in features.values()):
        raise Error(f"{source / INFO}: expected features by name, found {type(features).__name__}")
    return features


def _rows(column: Any) -> Array:
    """Convert a column, which may have nested lists, to an array (rows,) or (rows, n)."""
    arrow, compute = optional("pyarrow", "lerobot"), optional("pyarrow.compute", "lerobot")
    array = column.combine_chunks()
    rows, nested = len(array), False
    while isinstance(array, (arrow.ListArray, arrow.LargeListArray, arrow.FixedSizeListArray)):
        lengths = compute.list_value_length(array).unique().to_pylist()
        if len(lengths) > 1:
            raise ValueError(f"lists of {' and '.join(map(str, lengths[:2]))} values")
        array, nested = array.flatten(), True
    numbers = np.asarray(array.to_numpy(zero_copy_only=False))
    if not is_numeric(numbers):
        raise ValueError(f"values of type {array.type}")
    return numbers.reshape(rows, -1) if nested and rows else numbers


def _episodes(
    arrays: Mapping[str, Array], observed: Sequence[str], signals: Sequence[str], actions: Sequence[str]
) -> Iterator[Recording]:
    order = np.lexsort((arrays[FRAME], arrays[EPISODE]))
    episodes, firsts = np.unique(arrays[EPISODE][order], return_index=True)
    for episode, rows in zip(episodes, np.split(order, firsts)[1:], strict=True):
        own = {name: arrays[name][rows] for name in observed}
        told = {name: arrays[name][rows] for name in signals if arrays[name][:1].size <= 1}
        shifted = {name: of_states(told[name]) if name.startswith(FOLLOWING) else told[name] for name in told}
        yield Recording(str(episode), own, shifted, {name: arrays[name][rows] for name in actions})
