"""Random observations, and the tasks that they belong to."""

import numpy as np
from numpy.typing import NDArray

from goalward import Cells, Continuous, Discrete, Task, Vector

REACH = Task("reach", Vector(3), Continuous(2), horizon_steps=20)
ROOMS = Task("rooms", Cells(4, 5, 3), Discrete(4), horizon_steps=20)


def walk(steps: int, seed: int) -> NDArray[np.float32]:
    """Draw the observations of a walk: (steps + 1, 3) numbers."""
    return np.random.default_rng(seed).normal(size=(steps + 1, 3)).astype(np.float32)


def rooms(steps: int, seed: int) -> NDArray[np.uint8]:
    """Draw observations of a grid: (steps + 1, 4, 5) classes."""
    return np.random.default_rng(seed).integers(0, 3, (steps + 1, 4, 5)).astype(np.uint8)
