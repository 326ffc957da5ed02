"""`Log`: what a run recorded, without duplicates, read during the run or after it."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

from google.protobuf.message import DecodeError

from goalward import recorded, schema
from goalward.error import Error, expecting
from goalward.log import tables
from goalward.log.tables import Columns
from goalward.log.trajectory import Trajectory, decoded
from goalward.log.undone import Mark, returns
from goalward.recorded import ACTIVE, BeginningError, Ending, RecordedFile
from goalward.scale import scaled
from goalward.task import Discrete, Task
from goalward.toml import tomllib

Source = Literal["training", "evaluation"]


class IncompleteLog(UserWarning):
    """A log file is incomplete: it is being written, or a crash or a bad disk has damaged it."""


@dataclass(frozen=True)
class _Topic:
    """A topic: its files, message class, the fields that identify a message, the first iteration undone."""

    name: str
    files: str
    kind: Any
    fields: tuple[str, ...]
    undone_from: int = 0

    def key(self, message: Any) -> tuple[int, ...]:
        return tuple(getattr(message, field) for field in self.fields)


_EPISODE = ("iteration", "lane", "episode")
_TRAINING = _Topic("/trajectory", "trajectories", schema.Trajectory, _EPISODE)
_SOURCES: dict[Source, _Topic] = {
    "training": _TRAINING,
    "evaluation": _Topic("/evaluation/trajectory", "trajectories", schema.Trajectory, _EPISODE),
}
_SCORES = _Topic("/proximity/score", "trajectories", schema.Score, _EPISODE)
_UPDATES = _Topic("/policy/update", "updates", schema.PolicyUpdate, ("iteration",))
_VERSION = ("iteration", "model_version")
# Offline training is recorded again before the first repeated iteration, so it must not count as undone.
_REWARD_UPDATES = _Topic("/proximity/update", "updates", schema.RewardUpdate, _VERSION, undone_from=1)

_Place = tuple[int, int]
"""The index of a file, and of a message in it."""


class _Record(NamedTuple):
    """A message with its topic, its place and its log time."""

    topic: _Topic
    message: Any
    place: _Place
    log_time: int


class Log:
    """The log of a run. Every call reads the current contents of the files.

    A run that went back to a checkpoint records some iterations twice. The later record counts; as long as
    there is none, the earlier one does not count either. Updates are read without trajectories, which are the
    first to show that a run went back; they count until the run has made the first of them again. Reading a
    file that is damaged or being written stops at its last complete record, warns with `IncompleteLog`, and
    continues with the next file.

    Attributes:
        folder: the folder of the log files, `log` in the run's folder.
        metadata: the metadata of the first file, by name.
        task: the task of the run.
        endings: how each file ended when it was last read, by path.
    """

    def __init__(self, run: str | Path) -> None:
        """Open the log of a run.

        Args:
            run: the folder of the run.

        Raises:
            Error: if the folder has no log, or its files belong to different runs.
        """
        self.folder = Path(run) / "log"
        self.endings: dict[Path, Ending] = {}
        files = [*self._files("trajectories"), *self._files("updates")]
        if not files:
            readable = " that can be read" if self.endings else ""
            raise Error(
                f"{self.folder}: expected files such as trajectories-00000.mcap, found none{readable}"
            )
        self.metadata = dict(files[0].metadata)
        for file in files:
            self._require_same_run(file)
        self.task: Task = files[0].task()

    @property
    def config(self) -> dict[str, Any]:
        """The complete effective configuration of the run.

        Raises:
            Error: if the log does not have one.
        """
        with expecting(
            f"{self.folder}: expected metadata `config` in TOML", KeyError, tomllib.TOMLDecodeError
        ):
            return tomllib.loads(self.metadata["config"])

    def trajectories(self, source: Source = "training") -> Iterator[Trajectory]:
        """Iterate over the episodes in the order in which they were recorded.

        Args:
            source: `training`, or `evaluation` for the episodes on evaluation seeds.

        Raises:
            Error: if the observations were left out of the log, or a message is damaged.
        """
        return (decoded(message, self.task) for message in self._messages(_topic(source)))

    def acted(self, trajectories: Iterable[Trajectory]) -> Iterator[Trajectory]:
        """Replace continuous actions by those that the environment acted on.

        The environment multiplies a recorded action by `environment.action_scale` and clips it to [-1, 1]. In
        a Gymnasium environment, -1 and 1 stand for the bounds of its action space.

        Args:
            trajectories: trajectories of this run.

        Raises:
            Error: if the log does not have the configuration.
        """
        if isinstance(self.task.action, Discrete):
            yield from trajectories
            return
        setting = self.config.get("environment", {})
        for trajectory in trajectories:
            yield replace(trajectory, actions=scaled(trajectory.actions, setting))

    def episodes(self, source: Source = "training") -> Columns:
        """Return a table with a row for each episode.

        Returns:
            Columns `iteration`, `lane`, `episode`, `policy_version`, `steps`, `success`, `steps_to_goal`,
            `ending` and `environment_return`, the sum of the environment's own rewards.

        Raises:
            Error: if a message is damaged.
        """
        return tables.of_episodes(self._messages(_topic(source)))

    def steps(self, source: Source = "training") -> Columns:
        """Return a table with a row for each step.

        Returns:
            Columns `iteration`, `lane`, `episode`; `step`, from 1 in each episode; `action`, or `action[0]`
            and so on, as the policy chose it; the environment's `reward`; and `log_prob`.

        Raises:
            Error: if a message is damaged.
        """
        return tables.of_steps(self._messages(_topic(source)), self.task)

    def scores(self) -> Columns:
        """Return the scores of the reward model for training episodes, a row for each observation.

        Returns:
            Columns `iteration`, `lane`, `episode`, `model_version`; `step`, the number of steps before the
            observation; `reward` of the step that led to it, NaN for the first; `proximity` and
            `uncertainty`, NaN for the first if the model scores steps instead of observations.

        Raises:
            Error: if a message is damaged.
        """
        return tables.of_scores(self._messages(_SCORES))

    def updates(self) -> Columns:
        """Return a row for each policy update, a column for each field of `PolicyUpdate` except `consumed`.

        Raises:
            Error: if a message is damaged.
        """
        return tables.of_updates(self._messages(_UPDATES), schema.PolicyUpdate)

    def reward_updates(self) -> Columns:
        """Return a row for each reward model update, a column for each field of `RewardUpdate`.

        Raises:
            Error: if a message is damaged.
        """
        return tables.of_updates(self._messages(_REWARD_UPDATES), schema.RewardUpdate)

    def _require_same_run(self, file: RecordedFile) -> None:
        if file.kind != recorded.RUN:
            raise Error(f"{file.path}: expected the log of a run, found {file.kind}")
        for key in ("task", "seed"):
            expected, found = self.metadata.get(key), file.metadata.get(key)
            if expected != found:
                where = f"{file.path}: expected {key} {expected} as in the run's first file"
                raise Error(f"{where}, found {found}")

    def _messages(self, topic: _Topic) -> Iterator[Any]:
        """Yield the messages of a topic that count."""
        files = self._files(topic.files)
        counting = self._counting(files, topic)
        for record in self._records(files, {topic}):
            if record.place in counting:
                yield record.message

    def _counting(self, files: list[RecordedFile], topic: _Topic) -> set[_Place]:
        """Find the messages that count: the last one of each identity, unless it was undone."""
        others = [] if topic.files == _UPDATES.files else self._files(_UPDATES.files)
        last: dict[tuple[int, ...], tuple[_Place, int]] = {}
        marks = []
        for found, message, place, log_time in self._records([*files, *others], {topic, _TRAINING, _UPDATES}):
            if found == topic:
                last[topic.key(message)] = place, log_time
            if found in (_TRAINING, _UPDATES):
                marks.append(Mark(log_time, message.iteration, found == _UPDATES))
        undoing = returns(marks)
        return {
            place
            for (iteration, *_), (place, log_time) in last.items()
            if iteration < topic.undone_from or not any(one.undoes(iteration, log_time) for one in undoing)
        }

    def _records(self, files: list[RecordedFile], topics: set[_Topic]) -> Iterator[_Record]:
        wanted = {topic.name: topic for topic in topics}
        for number, file in enumerate(files):
            for place, (name, log_time, data) in enumerate(file.messages()):
                if name not in wanted:
                    continue
                with expecting(f"{file.path}: expected messages of {name}", DecodeError):
                    message = wanted[name].kind.FromString(data)
                yield _Record(wanted[name], message, (number, place), log_time)
            self._note(file.path, file.ending)

    def _files(self, contents: str) -> list[RecordedFile]:
        """Open the files of these contents, oldest first."""
        pattern = re.compile(rf"{contents}-(\d+)\.mcap({re.escape(ACTIVE)})?")
        with expecting(f"{self.folder}: expected the folder of a log", OSError):
            found = [(pattern.fullmatch(path.name), path) for path in self.folder.iterdir()]
        numbered = sorted((int(match[1]), path) for match, path in found if match)
        opened = (self._opened(path) for _, path in numbered)
        return [file for file in opened if file is not None]

    def _opened(self, path: Path) -> RecordedFile | None:
        """Open a file; None if its beginning is damaged, or not yet written."""
        try:
            return RecordedFile(path)
        except BeginningError as error:
            self._note(path, Ending(False, str(error).removeprefix(f"{path}: ")))
            return None

    def _note(self, path: Path, ending: Ending) -> None:
        if not ending.complete and path not in self.endings:
            warnings.warn(f"{path}: {ending.words}", IncompleteLog, stacklevel=2)
        self.endings[path] = ending


def _topic(source: Source) -> _Topic:
    if source not in _SOURCES:
        raise Error(f"source: expected {' or '.join(_SOURCES)}, found {source}")
    return _SOURCES[source]
