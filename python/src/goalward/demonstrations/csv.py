"""CSV files with a header: a row for each observation, a column for each number.

The column `episode`, `episode_id` or `episode_index` says which episode a row belongs to; the rows of an
episode are in order. Columns with values other than numbers, true and false are left out.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from goalward.demonstrations.recordings import Array, Recording, Wanted
from goalward.error import Error, expecting

SUCCESS = ("success", "is_success")
EPISODE = ("episode", "episode_id", "episode_index")
_WORDS = {"true": 1.0, "false": 0.0}


def recordings(source: Path, wanted: Wanted) -> Iterator[Recording]:
    """Read the episodes of a file, in the order of their first rows.

    Args:
        source: the `.csv` file.
        wanted: not used, because every column of numbers may be an observation.

    Raises:
        Error: if the file is not CSV, has no episode column, or has rows of different lengths.
    """
    names, rows = _table(source)
    episode = next((name for name in EPISODE if name in names), None)
    if episode is None:
        raise Error(f"{source}: expected a column {' or '.join(EPISODE)}, found {', '.join(names) or 'none'}")
    cells = dict(zip(names, zip(*rows, strict=True), strict=True))
    ids = cells.pop(episode)
    columns = {name: _numbers(texts) for name, texts in cells.items()}
    numeric = {name: column for name, column in columns.items() if column is not None}
    places: dict[str, list[int]] = {}
    for place, name in enumerate(ids):
        places.setdefault(name, []).append(place)
    for name, own in places.items():
        taken = {key: column[own] for key, column in numeric.items()}
        yield Recording(name, taken, taken, taken)


def _table(source: Path) -> tuple[list[str], list[list[str]]]:
    with (
        expecting(f"{source}: expected a CSV file", OSError, ValueError, csv.Error),
        source.open(newline="", encoding="utf-8-sig") as file,
    ):
        reader = csv.reader(file)
        names = next(reader, [])
        lines = [(reader.line_num, row) for row in reader if row]
    if len(set(names)) < len(names):
        raise Error(f"{source}: expected columns of differing names, found {', '.join(names)}")
    for line, row in lines:
        if len(row) != len(names):
            raise Error(f"{source}: line {line}: expected {len(names)} columns, found {len(row)}")
    if not lines:
        raise Error(f"{source}: expected rows below the header, found none")
    return names, [row for _, row in lines]


def _numbers(texts: Sequence[str]) -> Array | None:
    """Parse the numbers of a column, NaN for an empty cell; return None if the column has other texts."""
    try:
        plain = (text.strip().lower() for text in texts)
        return np.array([_WORDS.get(text, text or "nan") for text in plain], np.float64)
    except ValueError:
        return None
