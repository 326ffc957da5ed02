"""The description of a task: its name, the shapes of observations and actions, and its longest episode."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from numbers import Integral
from pathlib import Path
from typing import Any

from goalward.error import Error, expecting, one_line
from goalward.toml import tomllib

MOST_OBSERVATION_BYTES = 1 << 20
MOST_ACTIONS = 256
LONGEST_HORIZON = 1_000_000


@dataclass(frozen=True)
class Vector:
    """Observations of `len` numbers, float32."""

    len: int

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of one observation: `(len,)`."""
        return (self.len,)

    @property
    def bytes(self) -> int:
        """Length of one observation in bytes."""
        return 4 * self.len


@dataclass(frozen=True)
class Cells:
    """Observations that are a grid; each cell is one of `classes` classes, uint8."""

    height: int
    width: int
    classes: int

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of one observation: `(height, width)`."""
        return (self.height, self.width)

    @property
    def bytes(self) -> int:
        """Length of one observation in bytes."""
        return self.height * self.width


@dataclass(frozen=True)
class Discrete:
    """Actions that are one of `count` choices, uint8."""

    count: int


@dataclass(frozen=True)
class Continuous:
    """Actions of `len` numbers, float32; the environment clips them to [-1, 1]."""

    len: int


Observation = Vector | Cells
Action = Discrete | Continuous


@dataclass(frozen=True)
class Task:
    """A task, as configurations and files of Goalward describe it.

    Attributes:
        name: up to 64 letters, digits, `-`, `_` and `.`, the first not `.`.
        observation: kind and size of one observation.
        action: kind and size of one action.
        horizon_steps: longest episode, in environment steps.
        labels: names of the numbers of a vector, or of the classes of cells; empty if they have none.
        deterministic: whether an episode depends only on its seed and its actions.
        tells_success: whether the environment tells if an episode reached the goal.
        program: the program that acts in the task; None for Goalward's own actor.
        program_sha256: SHA-256 of that program.
    """

    name: str
    observation: Observation
    action: Action
    horizon_steps: int
    labels: tuple[str, ...] = ()
    deterministic: bool = True
    tells_success: bool = True
    program: str | None = None
    program_sha256: str | None = None

    def __post_init__(self) -> None:
        """Refuse values that Goalward would refuse.

        Raises:
            Error: if a value is out of range; names the first such key.
        """
        object.__setattr__(self, "labels", tuple(self.labels))
        plain = re.fullmatch(r"[A-Za-z0-9_-][A-Za-z0-9._-]{0,63}", self.name)
        _require(plain, "name", "up to 64 letters, digits, `-`, `_` and `.`, the first not `.`", self.name)
        self._require_observation()
        _require_number("action", _size(self.action), 1, MOST_ACTIONS)
        _require_number("horizon_steps", self.horizon_steps, 1, LONGEST_HORIZON)

    def _require_observation(self) -> None:
        shape = self.observation
        for key, value in asdict(shape).items():
            _require_number(f"observation.{key}", value, 1, MOST_OBSERVATION_BYTES)
        if isinstance(shape, Cells):
            _require_number("observation.classes", shape.classes, 1, 256)
        _require_number("observation", shape.bytes, 1, MOST_OBSERVATION_BYTES)
        parts = shape.classes if isinstance(shape, Cells) else shape.len
        fits = len(self.labels) in (0, parts)
        _require(fits, "labels", f"none, or {parts}, one for each class or number", len(self.labels))

    @classmethod
    def from_toml(cls, path: str | Path) -> Task:
        """Read the `[task]` table of a task file, or of a run's `config.toml`.

        Raises:
            Error: if the file cannot be read or does not describe a task.
        """
        with expecting(f"{path}: expected the file of a task", OSError, ValueError):
            document = tomllib.loads(Path(path).read_text(encoding="utf-8"))
        if not isinstance(document.get("task"), dict):
            raise Error(f"{path}: expected a table [task], found {', '.join(document) or 'nothing'}")
        return cls.from_table(document["task"])

    @classmethod
    def from_json(cls, text: str) -> Task:
        """Read the JSON of a task, such as the metadata `spec` of Goalward's files.

        Raises:
            Error: if the text does not describe a task.
        """
        with expecting("task: expected JSON", ValueError):
            table = json.loads(text)
        if not isinstance(table, dict):
            raise Error(f"task: expected a JSON object, found {type(table).__name__}")
        return cls.from_table(table)

    @classmethod
    def from_table(cls, table: Mapping[str, Any]) -> Task:
        """Make a task from the keys and values of its table.

        Raises:
            Error: if a key is missing, unknown or out of range; names the first such key.
        """
        known = [field.name for field in fields(cls)]
        unknown = next((key for key in table if key not in known), None)
        _require(unknown is None, str(unknown), f"one of {', '.join(known)}", "an unknown key")
        missing = next((key for key in known[:4] if key not in table), None)
        _require(missing is None, str(missing), "a value", "none")
        _require(isinstance(table["name"], str), "name", "a text", table["name"])
        values = dict(table)
        values["observation"] = _shape("observation", table["observation"], vector=Vector, cells=Cells)
        values["action"] = _shape("action", table["action"], discrete=Discrete, continuous=Continuous)
        labels = table.get("labels", ())
        texts = isinstance(labels, (list, tuple)) and all(isinstance(one, str) for one in labels)
        _require(texts, "labels", "a list of texts", labels)
        values["labels"] = tuple(labels)
        for key in ("deterministic", "tells_success"):
            _require(isinstance(table.get(key, True), bool), key, "true or false", table.get(key))
        return cls(**values)

    def to_json(self) -> str:
        """Return the JSON of the task, as `from_json` and Goalward read it."""
        table = {key: value for key, value in asdict(self).items() if value is not None and value != ()}
        for key, shape in (("observation", self.observation), ("action", self.action)):
            table[key] = {type(shape).__name__.lower(): asdict(shape)}
        return json.dumps(table, default=int)  # whole numbers may be NumPy's


def _size(action: Action) -> int:
    return action.count if isinstance(action, Discrete) else action.len


def _shape(key: str, table: Any, **kinds: Any) -> Any:
    named = isinstance(table, dict) and len(table) == 1
    kind = next(iter(table), "nothing") if isinstance(table, dict) else table
    _require(named and kind in kinds, key, " or ".join(kinds), kind)
    names = [field.name for field in fields(kinds[kind])]
    sizes = table[kind]
    found = sorted(sizes) if isinstance(sizes, dict) else sizes
    _require(found == sorted(names), f"{key}.{kind}", ", ".join(names), found)
    return kinds[kind](**sizes)


def _require_number(key: str, value: Any, least: int, most: int) -> None:
    whole = isinstance(value, Integral) and not isinstance(value, bool)
    _require(whole and least <= value <= most, key, f"a number from {least} to {most}", value)


def _require(holds: object, key: str, expected: str, found: object) -> None:
    if not holds:
        raise Error(f"task.{key}: expected {expected}, found {one_line(found)}")
