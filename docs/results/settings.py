"""The settings that decide a run's result, assembled as `goalward train` does.

The defaults come first, then a task file, one of its presets, a method's changes, and `key=value` settings;
later ones win. Names of method and preset are left out, because two with the same settings give the same run.
"""

from functools import cache, reduce
from pathlib import Path
from typing import Any

import tomllib

REPOSITORY = Path(__file__).resolve().parents[2]

# Keys that do not decide a result: names whose contents are in other keys, the tables of all learners, and
# tables that cannot change a result.
LEFT_OUT = ["method", "preset", "learners", "resources", "checkpoint", "log"]

Table = dict[str, Any]
# Keys and values.
Settings = frozenset[tuple[str, Any]]


def resolved(task: str, preset: str | None, method: str, changes: list[str]) -> Settings:
    """Returns all settings of a run of a task."""
    file = read(f"deploy/tasks/{task.replace('-', '_')}.toml")
    presets = file.get("preset", {})
    layers = [defaults(file), without(file, "preset"), presets[preset] if preset else {}]
    layers += [of_method(method, task), *map(setting, changes)]
    whole = reduce(merged, layers, {})
    return frozenset(flat(without(whole, *LEFT_OUT)).items())


def defaults(file: Table) -> Table:
    """Returns the defaults of all tasks, merged with those for this task's kind of observations."""
    found = read("protocol/run/src/config/defaults.toml")
    of_kinds = [found[kind] for kind in ("cells", "vector") if kind in file["task"]["observation"]]
    return reduce(merged, of_kinds, without(found, "cells", "vector"))


def of_method(name: str, task: str) -> Table:
    """Returns a method's changes for a task; changes for this task alone win."""
    changes = whole(name)
    return merged(without(changes, "about", "task"), changes.get("task", {}).get(task, {}))


def whole(method: str) -> Table:
    """Returns a method's table, merged over that of the method it is like."""
    own = read("deploy/methods.toml")[method]
    return merged(whole(own["like"]), without(own, "like")) if "like" in own else own


def setting(text: str) -> Table:
    """Parses `key=value`; a value that is not valid TOML is text."""
    key, value = text.split("=", 1)
    try:
        return tomllib.loads(f"{key} = {value}")
    except tomllib.TOMLDecodeError:
        return tomllib.loads(f'{key} = "{value}"')


@cache
def read(file: str) -> Table:
    """Reads a TOML file of the repository."""
    return tomllib.loads((REPOSITORY / file).read_text())


def without(table: Table, *names: str) -> Table:
    """Returns a table without some of its entries."""
    return {name: value for name, value in table.items() if name not in names}


def merged(table: Table, changes: Table) -> Table:
    """Returns a table with another one merged over it."""
    laid = {
        name: merged(table[name], value)
        if isinstance(value, dict) and isinstance(table.get(name), dict)
        else value
        for name, value in changes.items()
    }
    return table | laid


def flat(table: Table) -> dict[str, Any]:
    """Returns the values of a table and its nested tables by dotted key."""
    found = {}
    for key, value in table.items():
        if isinstance(value, dict):
            found |= {f"{key}.{rest}": inner for rest, inner in flat(value).items()}
        else:
            found[key] = tuple(value) if isinstance(value, list) else value
    return found
