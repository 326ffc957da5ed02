"""The source formats: detection of a data set's format, and conversion to demonstrations."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from goalward.demonstrations import csv, lerobot, mcap, minari, npz, robomimic
from goalward.demonstrations.episode import Episode
from goalward.demonstrations.recordings import Recording, Wanted
from goalward.demonstrations.selection import ALL, Selection
from goalward.error import Error
from goalward.task import Task

AUTO = "auto"


@dataclass(frozen=True)
class Format:
    """A source format.

    Attributes:
        recordings: reads the wanted parts of the episodes at a path.
        is_at: tells whether an existing path looks like this format.
        success: the keys that indicate success by the format's convention.
    """

    recordings: Callable[[Path, Wanted], Iterator[Recording]]
    is_at: Callable[[Path], bool]
    success: tuple[str, ...]


@dataclass(frozen=True)
class Loaded:
    """The result of loading a data set.

    Attributes:
        episodes: the demonstrations.
        left_out: number of episodes left out because they did not reach the goal, or began there.
    """

    episodes: list[Episode]
    left_out: int


def _ends(*endings: str) -> Callable[[Path], bool]:
    return lambda path: path.is_file() and path.suffix in endings


def _is_minari(path: Path) -> bool:
    folders = (path, path / "data")
    return any((folder / "metadata.json").is_file() for folder in folders)


def _is_bag(path: Path) -> bool:
    patterns = ("*.mcap", mcap.BAG, f"*/{mcap.BAG}")
    return _ends(".mcap")(path) or any(any(path.glob(pattern)) for pattern in patterns)


FORMATS = {
    "npz": Format(npz.recordings, _ends(".npz"), npz.SUCCESS),
    "csv": Format(csv.recordings, _ends(".csv"), csv.SUCCESS),
    "lerobot": Format(lerobot.recordings, lambda path: (path / lerobot.INFO).is_file(), lerobot.SUCCESS),
    "minari": Format(minari.recordings, _is_minari, minari.SUCCESS),
    "robomimic": Format(robomimic.recordings, _ends(".hdf5", ".h5"), robomimic.SUCCESS),
    "mcap": Format(mcap.recordings, _is_bag, mcap.SUCCESS),
}


def load(
    source: str | Path,
    task: Task,
    *,
    format: str = AUTO,  # noqa: A002
    keys: Sequence[str] | None = None,
    success: str | None = None,
    labels: Literal["match", "ignore"] = "match",
    episodes: int | None = None,
    actions: Sequence[str] = (),
) -> Loaded:
    """Make demonstrations from a data set, each up to where it first reached the goal.

    Args:
        source: the file or folder of the data set.
        task: the task whose observations the episodes must fit.
        format: one of `FORMATS`, or `auto` to detect it from the path.
        keys: observation keys, in the order of the task's observation; None for all, if they fit.
        success: `all` if every episode reaches the goal at its last observation; or the key of a signal for
            reaching the goal: episodes that do not reach it are left out; None for the format's own key.
        labels: `match` to refuse keys that differ from the parts named by the task's labels; `ignore` to
            accept them.
        episodes: maximum number of demonstrations, taken from the beginning; None for all.
        actions: keys of the actions, choices or numbers in [-1, 1]; without keys, states only are taken.

    Raises:
        Error: if the data set cannot be read or does not fit; the line names the episode and the key.
    """
    source = Path(source)
    if episodes is not None and episodes < 1:
        raise Error(f"episodes: expected a number from 1, found {episodes}")
    chosen = _format(source, format)
    wanted = Wanted(keys, None if success == ALL else success, actions)
    selection = Selection(task, keys, success, chosen.success, labels, actions)
    taken: list[Episode] = []
    left_out = 0
    for episode in selection.episodes(chosen.recordings(source, wanted)):
        if episode is None:
            left_out += 1
            continue
        taken.append(episode)
        if len(taken) == episodes:
            break
    if not taken:
        found = f"none that reaches it ({left_out} left out)" if left_out else "no episode"
        raise Error(f"{source}: expected at least one episode that reaches the goal, found {found}")
    return Loaded(taken, left_out)


def _format(source: Path, name: str) -> Format:
    if name != AUTO and name not in FORMATS:
        raise Error(f"format: expected {AUTO}, {', '.join(FORMATS)}, found {name}")
    if not source.exists():
        raise Error(f"{source}: expected a file or a folder, found none")
    if name != AUTO:
        return FORMATS[name]
    found = next((candidate for candidate in FORMATS.values() if candidate.is_at(source)), None)
    if found is None:
        raise Error(
            f"{source}: expected a data set of {', '.join(FORMATS)}, found none of them; --format says which"
        )
    return found
