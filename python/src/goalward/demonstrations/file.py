"""Reading and writing of demonstration files for `goalward train --demonstrations`."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from google.protobuf.message import DecodeError
from mcap.writer import Writer
from numpy.typing import NDArray

from goalward import recorded, schema
from goalward.demonstrations.episode import Episode
from goalward.error import Error, expecting
from goalward.recorded import RecordedFile
from goalward.replacing import new_file, require_absent
from goalward.scale import scaled
from goalward.task import Cells, Discrete, Task
from goalward.version import __version__

TOPIC = "/trajectory"
LARGEST_SEED = (1 << 64) - 1

# Goalward's limits: bytes of one demonstration, bytes of all of them, and its overhead for each.
LONGEST_MESSAGE = recorded.LONGEST_RECORD // 2
MOST_BYTES = 1 << 30
HELD_BYTES = 512


@dataclass(frozen=True)
class Demonstrations:
    """The contents of a demonstration file.

    Attributes:
        task: the demonstrated task.
        episodes: the demonstrations, in the order of the file.
        metadata: the file's metadata, by name.
    """

    task: Task
    episodes: list[Episode]
    metadata: dict[str, str]


def write(
    path: str | Path, episodes: Iterable[Episode], task: Task, seed: int = 0, *, overwrite: bool = False
) -> None:
    """Write demonstrations to an MCAP file, completely or not at all.

    The file does not say in which setting of the environment they were recorded, such as `coverage`. A run
    takes them as recorded in the agent's, with actions that are not scaled.

    Args:
        path: the path of the file.
        episodes: at least one episode; each is checked against the task. All have actions, or none has.
        task: the demonstrated task.
        seed: the seed of the episodes' random streams, if they have any.
        overwrite: whether an existing file is replaced.

    Raises:
        Error: if an episode does not fit the task (says in which episode, what was expected and found),
            there is no episode, the file exists, or writing fails.
    """
    path = Path(path)
    require_absent(path, overwrite=overwrite)
    if not 0 <= seed <= LARGEST_SEED:
        raise Error(f"seed: expected a number from 0 to {LARGEST_SEED}, found {seed}")
    messages = list(_encoded(episodes, task, seed))
    if not messages:
        raise Error(f"{path}: expected at least one episode, found none")
    metadata = {
        "format_version": str(recorded.FORMAT_VERSION),
        "goalward_version": __version__,
        "task": task.name,
        "seed": str(seed),
        "episodes": str(len(messages)),
        "spec": task.to_json(),
    }
    with new_file(path, overwrite=overwrite) as file:
        _write(file, metadata, messages)


def read(path: str | Path) -> Demonstrations:
    """Read a demonstration file.

    Returns:
        The task and the episodes, with observations as float32 numbers or uint8 classes, and with continuous
        actions as the environment acted on them: scaled by the file's setting, and clipped to [-1, 1].

    Raises:
        Error: if the file cannot be read, is damaged, or is not a demonstration file.
    """
    file = RecordedFile(Path(path))
    if file.kind != recorded.DEMONSTRATIONS:
        raise Error(f"{path}: expected demonstrations, found the log of a run")
    task, setting = file.task(), _setting(file)
    data = [message.data for message in file.messages() if message.topic == TOPIC]
    if not file.ending.complete:
        raise Error(f"{path}: expected a whole file, found it {file.ending.words}")
    with expecting(f"{path}: expected trajectories", DecodeError):
        episodes = [_decoded(one, task, number, setting) for number, one in enumerate(data)]
    return Demonstrations(task, episodes, dict(file.metadata))


def _setting(file: RecordedFile) -> Mapping[str, Any]:
    """Return the setting of the environment that the file was recorded in; empty if it does not say."""
    with expecting(f"{file.path}: expected metadata `setting` in JSON", ValueError):
        setting = json.loads(file.metadata.get("setting", "{}"))
    if not isinstance(setting, dict):
        raise Error(f"{file.path}: setting: expected a JSON object, found {type(setting).__name__}")
    return setting


def _encoded(episodes: Iterable[Episode], task: Task, seed: int) -> Iterator[bytes]:
    with_actions: bool | None = None
    held = 0
    for number, episode in enumerate(episodes):
        checked = episode.checked(task, number)
        has_actions = checked.actions is not None
        if with_actions not in (None, has_actions):
            expected, found = ("actions", "none") if with_actions else ("no actions", "some")
            raise Error(f"episode {episode.name or number}: expected {expected} as before, found {found}")
        with_actions = has_actions
        message = _message(checked, task, number, seed).SerializeToString()
        held += len(message) + HELD_BYTES
        _require_room(f"episode {episode.name or number}", len(message), held)
        yield message


def _require_room(where: str, length: int, held: int) -> None:
    if length > LONGEST_MESSAGE:
        raise Error(f"{where}: expected up to {LONGEST_MESSAGE} bytes, found {length}")
    if held > MOST_BYTES:
        raise Error(f"{where}: expected up to {MOST_BYTES} bytes with those before, found {held}")


def _message(episode: Episode, task: Task, number: int, seed: int) -> Any:
    observations = np.asarray(episode.observations)
    steps = len(observations) - 1
    at_goal = task.tells_success and episode.steps_to_goal == steps
    message = schema.Trajectory(
        task=task.name,
        source=schema.DEMONSTRATION,
        episode=number,
        run_seed=seed,
        steps=steps,
        observation_shape=task.observation.shape,
        ending=schema.GOAL_REACHED if at_goal else schema.TRUNCATED,
        success=task.tells_success,
        steps_to_goal=episode.steps_to_goal if task.tells_success else 0,
    )
    if isinstance(task.observation, Cells):
        message.cells = observations.tobytes()
    else:
        message.values.extend(observations.ravel())
    if episode.actions is not None:
        _add_actions(message, np.asarray(episode.actions), task)
    if episode.rewards is not None:
        message.environment_rewards.extend(np.asarray(episode.rewards))
    return message


def _add_actions(message: Any, actions: NDArray[Any], task: Task) -> None:
    if isinstance(task.action, Discrete):
        message.discrete_actions = actions.tobytes()
    else:
        message.continuous_actions.extend(actions.ravel())


def _write(file: BinaryIO, metadata: dict[str, str], messages: list[bytes]) -> None:
    # Goalward expects the metadata in the first record after the header, so it is written first.
    writer = Writer(file)
    writer.start(library=f"goalward-python/{__version__}")
    writer.add_metadata(recorded.DEMONSTRATIONS, metadata)
    name = f"{schema.PACKAGE}.Trajectory"
    schema_id = writer.register_schema(name, "protobuf", schema.DESCRIPTORS)
    channel = writer.register_channel(TOPIC, "protobuf", schema_id)
    for number, message in enumerate(messages):
        # The log time counts episodes, so the same demonstrations give the same file every time.
        writer.add_message(channel, log_time=number, data=message, publish_time=number, sequence=number)
    writer.finish()  # type: ignore[no-untyped-call]


def _decoded(data: bytes, task: Task, number: int, setting: Mapping[str, Any]) -> Episode:
    message = schema.Trajectory.FromString(data)
    if isinstance(task.observation, Cells):
        observations = np.frombuffer(message.cells, np.uint8)
    else:
        observations = np.array(message.values, np.float32)
    episode = Episode(
        observations=_rows(observations, task.observation.shape, message.steps + 1, number),
        actions=_actions(message, task, number, setting),
        rewards=np.array(message.environment_rewards, np.float32) if message.environment_rewards else None,
        steps_to_goal=message.steps_to_goal or None,
    )
    return episode.checked(task, number)


def _actions(message: Any, task: Task, number: int, setting: Mapping[str, Any]) -> NDArray[Any] | None:
    if message.discrete_actions:
        return np.frombuffer(message.discrete_actions, np.uint8)
    if message.continuous_actions and not isinstance(task.action, Discrete):
        numbers = np.array(message.continuous_actions, np.float32)
        return scaled(_rows(numbers, (task.action.len,), message.steps, number), setting)
    return None


def _rows(flat: NDArray[Any], shape: tuple[int, ...], rows: int, number: int) -> NDArray[Any]:
    expected = rows * int(np.prod(shape))
    if flat.size != expected:
        raise Error(f"episode {number}: expected {expected} numbers, found {flat.size}")
    return flat.reshape(rows, *shape)
