"""Tables of a run's records, as columns: NumPy arrays of equal length by name."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from itertools import chain
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from goalward import schema
from goalward.error import Error
from goalward.log.trajectory import actions, ending, place
from goalward.packages import optional
from goalward.task import Discrete, Task

if TYPE_CHECKING:
    import pandas
    import polars

Columns = dict[str, NDArray[Any]]

_NAMES = ("iteration", "lane", "episode")
_OF_EPISODES = (*_NAMES, "policy_version", "steps", "success", "steps_to_goal")


def to_polars(columns: Mapping[str, NDArray[Any]]) -> polars.DataFrame:
    """Convert a table to Polars.

    Raises:
        Error: if polars is not installed.
    """
    frame: polars.DataFrame = optional("polars", "polars").DataFrame(dict(columns))
    return frame


def to_pandas(columns: Mapping[str, NDArray[Any]]) -> pandas.DataFrame:
    """Convert a table to pandas.

    Raises:
        Error: if pandas is not installed.
    """
    frame: pandas.DataFrame = optional("pandas", "pandas").DataFrame(dict(columns))
    return frame


def of_updates(messages: Iterable[Any], kind: Any) -> Columns:
    """Make a row for each update, with every field of its message that is a single value."""
    default = kind()
    names = [field.name for field in kind.DESCRIPTOR.fields]
    single = [name for name in names if isinstance(getattr(default, name), (bool, int, float, str))]
    rows = ([getattr(message, name) for name in single] for message in messages)
    return _of_rows(rows, {name: _type(kind, name) for name in single})


def of_episodes(messages: Iterable[Any]) -> Columns:
    """Make a row for each trajectory: its identity, length, ending and sum of environment rewards."""
    types: dict[str, Any] = {name: _type(schema.Trajectory, name) for name in _OF_EPISODES}
    types |= {"ending": np.str_, "environment_return": np.float64}
    return _of_rows(map(_episode, messages), types)


def _episode(message: Any) -> list[Any]:
    values = [getattr(message, name) for name in _OF_EPISODES]
    return [*values, ending(message), sum(message.environment_rewards)]


def of_steps(messages: Iterable[Any], task: Task) -> Columns:
    """Make a row for each step: its number from 1, action, reward and log-probability."""
    return _joined(messages, _NAMES, schema.Trajectory(), lambda message: _steps(message, task))


def of_scores(messages: Iterable[Any]) -> Columns:
    """Make a row for each observation: its number from 0 and its scores, NaN where the model has none."""
    return _joined(messages, (*_NAMES, "model_version"), schema.Score(), _scores)


def _steps(message: Any, task: Task) -> Columns:
    columns: Columns = {"step": np.arange(1, message.steps + 1)}
    taken = actions(message, task)
    if isinstance(task.action, Discrete):
        columns["action"] = taken
    else:
        columns |= {f"action[{index}]": taken[:, index] for index in range(task.action.len)}
    columns["reward"] = np.array(message.environment_rewards, np.float32)
    columns["log_prob"] = np.array(message.log_probs, np.float32)
    return columns


def _scores(message: Any) -> Columns:
    rows = len(message.rewards) + 1 if message.rewards else 0
    columns: Columns = {"step": np.arange(rows)}
    for column, field in (("reward", "rewards"), ("proximity", "proximity"), ("uncertainty", "uncertainty")):
        values = np.array(getattr(message, field), np.float32)
        if len(values) > rows:
            raise Error(f"{place(message)}: {field}: expected at most {rows} values, found {len(values)}")
        columns[column] = _behind(values, rows)
    return columns


def _behind(values: NDArray[np.float32], rows: int) -> NDArray[np.float32]:
    """Align values to the last of `rows` rows: a step's value is in the row of the observation after it."""
    column = np.full(rows, np.nan, np.float32)
    column[rows - len(values) :] = values
    return column


def _joined(
    messages: Iterable[Any], names: tuple[str, ...], none: Any, columns_of: Callable[[Any], Columns]
) -> Columns:
    """Join the rows of all messages and their identities; the empty message `none` determines the types."""
    named, parts = [], []
    for message in chain([none], messages):
        named.append([getattr(message, name) for name in names])
        parts.append(columns_of(message))
    counts = [len(part["step"]) for part in parts]
    columns = {
        name: np.repeat(np.array(values, np.int64), counts)
        for name, values in zip(names, zip(*named, strict=True), strict=True)
    }
    return columns | {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def _of_rows(rows: Iterable[list[Any]], types: Mapping[str, Any]) -> Columns:
    columns = list(zip(*rows, strict=True)) or [()] * len(types)
    return {name: np.array(column, types[name]) for name, column in zip(types, columns, strict=True)}


def _type(kind: Any, name: str) -> Any:
    field = kind.DESCRIPTOR.fields_by_name[name]
    types = {field.CPPTYPE_DOUBLE: np.float64, field.CPPTYPE_STRING: np.str_, field.CPPTYPE_BOOL: np.bool_}
    return types.get(field.cpp_type, np.int64)
