"""Pivot tables of runs outside the plans, as `pivots.toml` and `quoted.toml` describe them."""

import statistics
import sys
from collections.abc import Callable
from functools import cache
from typing import Any

import tomllib
from cells import head, line, mean_with_interval, percent
from data import FIRST_TUNING_SEED, HERE, Row, Seeds, rates, read

DESCRIPTIONS = HERE / "pivots.toml"
PIVOTS = tomllib.loads(DESCRIPTIONS.read_text()) | tomllib.loads((HERE / "quoted.toml").read_text())
# Keys of a table, a row or a column that do not select runs.
SAYS = ["title", "data", "value", "shows"]
DEFAULTS = {"data": "settings.csv", "value": "evaluation_success_rate", "shows": "seeds"}

Entry = dict[str, Any]


def pivot(name: str) -> str:
    """Makes a table; a cell without runs is empty."""
    table = PIVOTS[name]
    columns, rows = table["columns"], table["rows"]
    cells = {(row, key): cell(name, key, row) for row in rows for key in columns}
    for kind, keys, place in (("rows", rows, 0), ("columns", columns, 1)):
        for key in keys:
            if not any(text for at, text in cells.items() if at[place] == key):
                sys.exit(f"{DESCRIPTIONS}: expected runs of {name}.{kind}.{key}, found none")
    text = head([table.get("title", ""), *(of.get("title", key) for key, of in columns.items())])
    for row, of in rows.items():
        text += line([of.get("title", row), *(cells[row, key] for key in columns)])
    return text


def cell(name: str, key: str, row: str) -> str:
    """Returns the text of a cell; several kinds of states are shown one after another."""
    whole = entry(name, key, row)
    states = whole.get("states")
    several = [whole | {"states": one} for one in states] if isinstance(states, list) else [whole]
    shown = (SHOWS[one["shows"]](list(found.values())) for one in several if (found := values(one)))
    return ", ".join(shown)


def column(name: str, key: str) -> dict[str, Seeds]:
    """Returns the values of all rows in a column."""
    return {row: values(entry(name, key, row)) for row in PIVOTS[name]["rows"]}


def entry(name: str, key: str, row: str) -> Entry:
    """Merges the entries of a table, a column and a row: settings are joined, of other keys the last wins."""
    table = PIVOTS[name]
    parts = [DEFAULTS, table["of"], table["columns"][key], table["rows"][row]]
    whole = {word: value for part in parts for word, value in part.items()}
    return whole | {"settings": " ".join(part["settings"] for part in parts if "settings" in part)}


def values(whole: Entry) -> Seeds:
    """Returns the values of the runs that an entry selects, by seed."""
    wanted = {key: value for key, value in whole.items() if key not in SAYS}
    data, value = whole["data"], whole["value"]
    runs = [run for run in rows_of(data) if described(run, wanted)]
    found = rates(runs, value)
    if len(found) < len(runs):
        seeds = " ".join(run["seed"] for run in runs)
        sys.exit(
            f"{HERE / data}: expected one {value} for each seed, found {len(found)} for {seeds}: {wanted}"
        )
    return found


@cache
def rows_of(data: str) -> list[Row]:
    """Reads the runs of a file, once for all cells."""
    return read(HERE / data)


def described(run: Row, wanted: Entry) -> bool:
    """Returns whether a run is one of the wanted ones."""
    return all(FITS[key](run, value) if key in FITS else run[key] == value for key, value in wanted.items())


def seeds(found: list[float]) -> str:
    """Lists every seed, in per cent."""
    return ", ".join(map(percent, found))


def seeds_and_mean(found: list[float]) -> str:
    """Lists every seed, then the mean and its interval, in per cent."""
    return f"{seeds(found)}: **{mean_with_interval(found)}**"


def plain_mean(found: list[float]) -> str:
    """Formats the mean of values that are not shares."""
    return f"{statistics.mean(found):.2f}"


def plain_mean_and_range(found: list[float]) -> str:
    """Formats the mean and the range of values that are not shares."""
    return f"{plain_mean(found)} ({min(found):.2f} to {max(found):.2f})"


SHOWS: dict[str, Callable[[list[float]], str]] = {
    "seeds": seeds,
    "seeds and mean": seeds_and_mean,
    "mean and interval": mean_with_interval,
    "plain mean": plain_mean,
    "plain mean and range": plain_mean_and_range,
}


def of_kind(run: Row, kind: str) -> bool:
    """Returns whether a run is of a kind: `reported` in results, or `tuning` of settings."""
    return (int(run["seed"]) < FIRST_TUNING_SEED) == {"reported": True, "tuning": False}[kind]


# Comparisons other than equality: settings may be in any order, steps are rounded to 100,000.
FITS: dict[str, Callable[[Row, Any], bool]] = {
    "settings": lambda run, settings: set(run["settings"].split()) == set(settings.split()),
    "steps": lambda run, steps: round(int(run["steps"]), -5) == steps,
    "seeds": of_kind,
}
