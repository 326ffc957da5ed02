"""Export of a log's trajectories as a Minari data set."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from goalward.error import Error, expecting
from goalward.log.run import Log
from goalward.log.trajectory import Trajectory
from goalward.packages import optional
from goalward.task import Cells, Discrete, Task


def write_minari(
    log: Log, dataset_id: str, trajectories: Iterable[Trajectory] | None = None, **about: Any
) -> Any:
    """Store trajectories as a data set in Minari's folder.

    The observation space is a Box, of int16 for grids. The action space is Discrete, or a Box of [-1, 1].
    Actions are those of `Log.acted`. `infos["success"]` says for each observation whether the goal has been
    reached.

    Args:
        log: the log of the run, which has the task.
        dataset_id: the data set's name, such as `reach/goal-proximity-v0`.
        trajectories: the trajectories to store; None for all training episodes.
        about: passed on to `minari.create_dataset_from_buffers`, for example `description` or `author`.

    Returns:
        The `minari.MinariDataset`.

    Raises:
        Error: if there is no trajectory, the data set exists, or minari is not installed.
    """
    minari, buffers = optional("minari", "minari"), optional("minari.data_collector", "minari")
    chosen = log.acted(log.trajectories() if trajectories is None else trajectories)
    observation_space, action_space = _spaces(log.task)
    dtype = observation_space.dtype
    stored = [_buffer(buffers, number, trajectory, dtype) for number, trajectory in enumerate(chosen)]
    if not stored:
        raise Error(f"{dataset_id}: expected at least one trajectory, found none")
    with expecting(f"{dataset_id}: expected the name of a new data set", ValueError, OSError):
        return minari.create_dataset_from_buffers(
            dataset_id,
            stored,
            observation_space=observation_space,
            action_space=action_space,
            **{"algorithm_name": str(log.config.get("method", "")), **about},
        )


def _spaces(task: Task) -> tuple[Any, Any]:
    spaces = optional("gymnasium", "minari").spaces
    shape = task.observation.shape
    if isinstance(task.observation, Cells):
        # Minari may mistake grids of uint8 for images, which it stores with lossy compression.
        observations = spaces.Box(0, task.observation.classes - 1, shape, np.int16)
    else:
        observations = spaces.Box(-np.inf, np.inf, shape, np.float32)
    if isinstance(task.action, Discrete):
        return observations, spaces.Discrete(task.action.count)
    return observations, spaces.Box(-1.0, 1.0, (task.action.len,), np.float32)


def _buffer(buffers: Any, number: int, trajectory: Trajectory, dtype: Any) -> Any:
    at_end = np.arange(1, trajectory.steps + 1) == trajectory.steps
    truncated = trajectory.ending == "truncated"
    discrete = trajectory.actions.ndim == 1
    reached = np.arange(trajectory.steps + 1) >= trajectory.steps_to_goal
    return buffers.EpisodeBuffer(
        id=number,
        observations=trajectory.observations.astype(dtype),
        actions=trajectory.actions.astype(np.int64 if discrete else np.float32),
        rewards=list(trajectory.rewards),
        terminations=list(at_end & (not truncated)),
        truncations=list(at_end & truncated),
        infos={"success": (reached & trajectory.success).tolist()},
    )
