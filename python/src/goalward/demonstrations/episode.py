"""`Episode`: one demonstration as arrays, checked against the shapes of its task."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from goalward.error import Error
from goalward.task import Cells, Discrete, Task

LARGEST_NUMBER = np.finfo(np.float32).max


@dataclass(frozen=True, eq=False)
class Episode:
    """One episode of T steps that reaches the goal.

    Attributes:
        observations: (T + 1, len) numbers, or (T + 1, height, width) cell classes.
        actions: (T, len) numbers in [-1, 1], on which the environment acted, or (T,) choices; None for states
            only.
        rewards: (T,) rewards of the environment; None if they were not recorded.
        steps_to_goal: number of steps after which the goal was first reached, 1 to T; None for T.
        name: the episode's name in the data set, for error messages.
    """

    observations: ArrayLike
    actions: ArrayLike | None = None
    rewards: ArrayLike | None = None
    steps_to_goal: int | None = None
    name: str = ""

    def checked(self, task: Task, number: int) -> Episode:
        """Return the checked episode, with arrays of the types that files have: uint8 and float32.

        Args:
            task: the task whose shapes the episode must have.
            number: the episode's index among the demonstrations, for error messages.

        Raises:
            Error: if the episode does not fit the task; says in which episode, what was expected and found.
        """
        where = f"episode {self.name or number}"
        observations = checked_observations(self.observations, task, where)
        steps = len(observations) - 1
        goal = steps if self.steps_to_goal is None else self.steps_to_goal
        _require(1 <= goal <= steps, where, "steps_to_goal", f"1 to {steps}", goal)
        actions = None if self.actions is None else _actions(self.actions, task, steps, where)
        rewards = None if self.rewards is None else _numbers(self.rewards, (steps,), where, "rewards")
        return Episode(observations, actions, rewards, goal, self.name)


def checked_observations(found: ArrayLike, task: Task, where: str) -> NDArray[Any]:
    """Return observations as (T + 1, ...) uint8 classes or float32 numbers.

    Args:
        found: the observations; grids may be flattened to (T + 1, height * width).
        task: the task that the observations must fit.
        where: the episode, for error messages.

    Raises:
        Error: if the shape, the number of steps or a value does not fit the task.
    """
    array = _array(found, where, "observations")
    spec = task.observation
    if isinstance(spec, Cells) and array.ndim == 2 and array.shape[1] == spec.height * spec.width:
        array = array.reshape(-1, *spec.shape)
    steps = max(len(array) - 1, 0) if array.ndim else 0
    horizon = task.horizon_steps
    _require(1 <= steps <= horizon, where, "steps", f"1 to {horizon}, the horizon of {task.name}", steps)
    if isinstance(spec, Cells):
        return _choices(array, (steps + 1, *spec.shape), spec.classes, where, "observations")
    return _numbers(array, (steps + 1, *spec.shape), where, "observations")


def _actions(found: ArrayLike, task: Task, steps: int, where: str) -> NDArray[Any]:
    if isinstance(task.action, Discrete):
        return _choices(found, (steps,), task.action.count, where, "actions")
    numbers = _numbers(found, (steps, task.action.len), where, "actions")
    _require_all(np.abs(numbers) <= 1, numbers, where, "actions", "a number in [-1, 1]")
    return numbers


def _numbers(found: ArrayLike, shape: tuple[int, ...], where: str, what: str) -> NDArray[np.float32]:
    array = _array(found, where, what)
    _require(array.shape == shape, where, what, f"shape {shape}", array.shape)
    finite = np.isfinite(array) & (np.abs(array) <= LARGEST_NUMBER)
    _require_all(finite, array, where, what, "a finite float32")
    return array.astype(np.float32)


def _choices(
    found: ArrayLike, shape: tuple[int, ...], count: int, where: str, what: str
) -> NDArray[np.uint8]:
    array = _array(found, where, what)
    _require(array.shape == shape, where, what, f"shape {shape}", array.shape)
    whole = (array >= 0) & (array < count) & (array == np.floor(array))
    _require_all(whole, array, where, what, f"a whole number below {count}")
    return array.astype(np.uint8)


def _array(found: ArrayLike, where: str, what: str) -> NDArray[Any]:
    try:
        array = np.asarray(found)
    except ValueError as cause:
        raise Error(f"{where}: {what}: expected one array, found rows of differing lengths") from cause
    _require(array.dtype.kind in "biuf", where, what, "numbers", f"values of type {array.dtype}")
    return array


def _require_all(holds: NDArray[np.bool_], array: NDArray[Any], where: str, what: str, expected: str) -> None:
    """Refuse an array that does not hold everywhere; name the first place where it does not."""
    if not holds.all():
        place = tuple(int(index) for index in np.argwhere(~holds)[0])
        _require(False, where, f"{what}{list(place)}", expected, array[place])


def _require(holds: object, where: str, what: str, expected: str, found: object) -> None:
    if not holds:
        raise Error(f"{where}: {what}: expected {expected}, found {found}")
