"""`Episode`: one demonstration as arrays, checked against the shapes of its task."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from goalward.arrays import checked_array, checked_choices, checked_numbers, require, require_all
from goalward.task import Cells, Discrete, Task


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
        require(1 <= goal <= steps, where, "steps_to_goal", f"1 to {steps}", goal)
        actions = None if self.actions is None else _actions(self.actions, task, steps, where)
        rewards = None if self.rewards is None else checked_numbers(self.rewards, (steps,), where, "rewards")
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
    array = checked_array(found, where, "observations")
    spec = task.observation
    if isinstance(spec, Cells) and array.ndim == 2 and array.shape[1] == spec.height * spec.width:
        array = array.reshape(-1, *spec.shape)
    steps = max(len(array) - 1, 0) if array.ndim else 0
    horizon = task.horizon_steps
    require(1 <= steps <= horizon, where, "steps", f"1 to {horizon}, the horizon of {task.name}", steps)
    if isinstance(spec, Cells):
        return checked_choices(array, (steps + 1, *spec.shape), spec.classes, where, "observations")
    return checked_numbers(array, (steps + 1, *spec.shape), where, "observations")


def _actions(found: ArrayLike, task: Task, steps: int, where: str) -> NDArray[Any]:
    if isinstance(task.action, Discrete):
        return checked_choices(found, (steps,), task.action.count, where, "actions")
    numbers = checked_numbers(found, (steps, task.action.len), where, "actions")
    require_all(np.abs(numbers) <= 1, numbers, where, "actions", "a number in [-1, 1]")
    return numbers
