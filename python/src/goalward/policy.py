"""Policies written by `goalward export`, run with onnxruntime."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from goalward.arrays import checked_array, checked_choices, checked_numbers, require
from goalward.error import Error, expecting
from goalward.packages import optional
from goalward.scale import scaled
from goalward.task import Cells, Discrete, Task, Vector
from goalward.toml import tomllib


class Policy:
    """A policy loaded from a file `policy.onnx`.

    Attributes:
        path: the path of the file.
        task: the task that it was trained in.
        config: the configuration of its run.
        metadata: all metadata of the file, by name.
    """

    def __init__(self, path: str | Path) -> None:
        """Load a policy.

        Raises:
            Error: if onnxruntime is missing, or the file was not written by `goalward export`.
        """
        runtime = optional("onnxruntime", "policy")
        self.path = Path(path)
        with expecting(f"{path}: expected an exported policy", Exception):
            options = {"providers": ["CPUExecutionProvider"]}
            self._session = runtime.InferenceSession(str(path), **options)
        self.metadata: dict[str, str] = self._session.get_modelmeta().custom_metadata_map
        names = [output.name for output in self._session.get_outputs()]
        missing = {"spec", "config"} - self.metadata.keys()
        if "action" not in names or missing:
            found = ", ".join([*names, *(f"no metadata `{name}`" for name in sorted(missing))])
            raise Error(f"{path}: expected a policy with the output `action`, found {found}")
        self.task = Task.from_json(self.metadata["spec"])
        self.config = tomllib.loads(self.metadata["config"])

    def act(self, observations: NDArray[Any], rng: np.random.Generator | None = None) -> NDArray[Any]:
        """Choose actions.

        Args:
            observations: raw observations, `(rows, len)` or `(rows, height, width)`; without `rows`, one
                observation.
            rng: draws the actions; without it, the most probable ones are taken.

        Returns:
            `(rows,)` choices, int64, or `(rows, len)` numbers in [-1, 1], float32; without `rows` for one
            observation.

        Raises:
            Error: if the observations do not have the task's shape, or are not finite numbers; in cells,
                classes.
        """
        spec, where, what = self.task.observation, str(self.path), "observations"
        shape = spec.shape
        rows = checked_array(observations, where, what)
        fits = rows.shape[-len(shape) :] == shape and rows.ndim - len(shape) in (0, 1)
        require(fits, where, what, f"shape {shape} or rows of it", rows.shape)
        if isinstance(spec, Cells):
            rows = checked_choices(rows, rows.shape, spec.classes, where, what)
        else:
            rows = checked_numbers(rows, rows.shape, where, what)
        outputs = self._outputs(rows.reshape(-1, *shape))
        actions = outputs["action"] if rng is None else self._sample(outputs, rng)
        return actions[0] if rows.ndim == len(shape) else actions

    def for_space(
        self, observation_space: Any, action_space: Any, rng: np.random.Generator | None = None
    ) -> Callable[[Any], Any]:
        """Make a function that maps an environment's observations to its actions.

        Args:
            observation_space: the environment's observation space, one of Gymnasium.
            action_space: the environment's action space.
            rng: draws the actions; without it, the most probable ones are taken.

        Returns:
            A function that takes one observation and returns one action, both in the environment's own form.

        Raises:
            Error: if Gymnasium is missing, the spaces are not those of a task, or they differ from those that
                the policy was trained in.
        """
        optional("gymnasium", "policy")
        from goalward import spaces

        with expecting(f"{self.path}: expected spaces of a task", spaces.Refused):
            observations, actions = spaces.observations_of(observation_space), spaces.actions_of(action_space)
        layout, labels = observations.layout()
        # A task need not have labels, and a grid's labels name its classes, which no space does.
        named = bool(self.task.labels) and isinstance(self.task.observation, Vector)
        expected = (*self._layout(), self.task.labels if named else ())
        found = layout, actions.spec, tuple(labels) if named else ()
        if expected != found:
            raise Error(f"{self.path}: expected the spaces {expected}, found {found}")
        row, shape = observations.row(), self.task.observation.shape

        def act(observation: Any) -> Any:
            observations.write(observation, row)
            chosen = self.act(row.reshape(shape), rng)
            kind = np.uint8 if isinstance(self.task.action, Discrete) else np.dtype("<f4")
            raw = np.atleast_2d(np.asarray(chosen, dtype=kind)).view(np.uint8)
            return actions.decode(raw)[0]

        return act

    def _layout(self) -> tuple[Any, Any]:
        def table(shape: Any) -> dict[str, dict[str, int]]:
            return {type(shape).__name__.lower(): dict(vars(shape))}

        return table(self.task.observation), table(self.task.action)

    def _outputs(self, rows: NDArray[Any]) -> dict[str, NDArray[Any]]:
        names = [output.name for output in self._session.get_outputs()]
        return dict(zip(names, self._session.run(None, {"observation": rows}), strict=True))

    def _sample(self, outputs: dict[str, NDArray[Any]], rng: np.random.Generator) -> NDArray[Any]:
        if "logits" in outputs:
            logits = outputs["logits"]
            return np.asarray(np.argmax(logits + rng.gumbel(size=logits.shape), axis=1))
        noise = rng.standard_normal(outputs["mean"].shape)
        numbers = outputs["mean"] + np.exp(outputs["log_standard_deviation"]) * noise
        if self.config["policy"]["distribution"] == "squashed-gaussian":
            numbers = np.tanh(numbers)
        return scaled(numbers, self.config["environment"])
