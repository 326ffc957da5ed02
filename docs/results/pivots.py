"""Tables of rows and columns from the data of runs that no plan has, as `pivots.toml` describes them."""

import statistics
import sys
from collections.abc import Callable
from functools import cache
from typing import Any

import tomllib
from cells import head, line, mean_with_interval, percent
from data import FIRST_TUNING_SEED, HERE, Row, Seeds, rates, read

DESCRIPTIONS = HERE / "pivots.toml"
PIVOTS = tomllib.loads(DESCRIPTIONS.read_text())
# What an entry of a table, a row or a column says beside which runs it has.
SAYS = ["title", "data", "value", "shows"]
DEFAULTS = {"data": "settings.csv", "value": "evaluation_success_rate", "shows": "seeds"}

Entry = dict[str, Any]


def pivot(name: str) -> str:
    """A table; a cell that has no runs is empty."""
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
    """What a cell shows; where it has several kinds of states, it shows one behind the other."""
    whole = entry(name, key, row)
    states = whole.get("states")
    several = [whole | {"states": one} for one in states] if isinstance(states, list) else [whole]
    shown = (SHOWS[one["shows"]](list(found.values())) for one in several if (found := values(one)))
    return ", ".join(shown)


def column(name: str, key: str) -> dict[str, Seeds]:
    """The values of all rows in a column."""
    return {row: values(entry(name, key, row)) for row in PIVOTS[name]["rows"]}


def entry(name: str, key: str, row: str) -> Entry:
    """What a table, a column and a row say as one; settings come together, of others the last wins."""
    table = PIVOTS[name]
    parts = [DEFAULTS, table["of"], table["columns"][key], table["rows"][row]]
    whole = {word: value for part in parts for word, value in part.items()}
    return whole | {"settings": " ".join(part["settings"] for part in parts if "settings" in part)}


def values(whole: Entry) -> Seeds:
    """The values of the runs that an entry names, by seed."""
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
    """The runs of a file, which every cell asks."""
    return read(HERE / data)


def described(run: Row, wanted: Entry) -> bool:
    """Whether a run is one of those that are wanted."""
    return all(FITS[key](run, value) if key in FITS else run[key] == value for key, value in wanted.items())


def seeds(found: list[float]) -> str:
    """Every seed, per cent."""
    return ", ".join(map(percent, found))


def seeds_and_mean(found: list[float]) -> str:
    """Every seed, then the mean and its interval, per cent."""
    return f"{seeds(found)}: **{mean_with_interval(found)}**"


def plain_mean(found: list[float]) -> str:
    """The mean of what is no share."""
    return f"{statistics.mean(found):.2f}"


def plain_mean_and_range(found: list[float]) -> str:
    """The mean and the range of what is no share."""
    return f"{plain_mean(found)} ({min(found):.2f} to {max(found):.2f})"


SHOWS: dict[str, Callable[[list[float]], str]] = {
    "seeds": seeds,
    "seeds and mean": seeds_and_mean,
    "mean and interval": mean_with_interval,
    "plain mean": plain_mean,
    "plain mean and range": plain_mean_and_range,
}


def of_kind(run: Row, kind: str) -> bool:
    """Whether a run is one of those that results report, or of those that settings were tuned on."""
    return (int(run["seed"]) < FIRST_TUNING_SEED) == {"reported": True, "tuning": False}[kind]


# What is not simply equal: settings come in any order, steps are counted in 100,000.
FITS: dict[str, Callable[[Row, Any], bool]] = {
    "settings": lambda run, settings: set(run["settings"].split()) == set(settings.split()),
    "steps": lambda run, steps: round(int(run["steps"]), -5) == steps,
    "seeds": of_kind,
}
