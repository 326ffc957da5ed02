"""The command line: `python -m goalward.demonstrations import` and `info`."""

from __future__ import annotations

import argparse
import json
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from goalward.demonstrations.episode import Episode
from goalward.demonstrations.file import read, write
from goalward.demonstrations.formats import AUTO, FORMATS, load
from goalward.error import Error
from goalward.replacing import require_absent
from goalward.task import Task

REFUSED = 2


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command.

    Args:
        arguments: the command line arguments without the program's name; None for those of this process.

    Returns:
        The exit status: 0, or 2 for input that cannot be used, with one line about it on standard error.
    """
    options = _parser().parse_args(arguments)
    try:
        print(_import(options) if options.command == "import" else _info(options.file, as_json=options.json))
    except Error as error:
        print(f"goalward: {error}", file=sys.stderr)
        return REFUSED
    return 0


def _parser() -> argparse.ArgumentParser:
    program, words = "python -m goalward.demonstrations", "Files of demonstrations."
    parser = argparse.ArgumentParser(program, description=words)
    commands = parser.add_subparsers(dest="command", required=True)
    importer = commands.add_parser("import", help="make a file of demonstrations of a data set")
    importer.add_argument("source", type=Path, help="file or folder of the data set")
    task = importer.add_mutually_exclusive_group(required=True)
    task.add_argument("--task", type=Path, help="the task's file, TOML")
    task.add_argument("--task-json", help=argparse.SUPPRESS)
    importer.add_argument("--task-argument", help=argparse.SUPPRESS)
    importer.add_argument("--out", type=Path, required=True, help="the MCAP file to write")
    importer.add_argument("--format", choices=[AUTO, *FORMATS], default=AUTO)
    importer.add_argument("--keys", type=_keys, help="observation keys, in the order of the task")
    importer.add_argument("--actions", type=_keys, default=[], help="keys of the actions; by default none")
    importer.add_argument("--success", help="`all`, or the key that tells which episodes succeed, and when")
    importer.add_argument("--labels", choices=["match", "ignore"], default="match")
    importer.add_argument("--episodes", type=_count, help="take so many at most")
    importer.add_argument("--overwrite", action="store_true", help="replace a file that is there")
    info = commands.add_parser("info", help="say what a file of demonstrations holds")
    info.add_argument("file", type=Path)
    info.add_argument("--json", action="store_true", help="print JSON for programs")
    return parser


def _keys(text: str) -> list[str]:
    return [key.strip() for key in text.split(",")]


def _count(text: str) -> int:
    if not text.isdecimal() or int(text) == 0:
        raise argparse.ArgumentTypeError(f"expected a number from 1, found {text}")
    return int(text)


def _import(options: argparse.Namespace) -> str:
    require_absent(options.out, overwrite=options.overwrite)
    task = Task.from_json(options.task_json) if options.task_json else Task.from_toml(options.task)
    loaded = load(
        options.source,
        task,
        format=options.format,
        keys=options.keys,
        success=options.success,
        labels=options.labels,
        episodes=options.episodes,
        actions=options.actions,
    )
    write(options.out, loaded.episodes, task, overwrite=options.overwrite)
    count = len(loaded.episodes)
    steps = f"{_steps(loaded.episodes)} steps{' and their actions' if options.actions else ''}"
    counts = f"{count} episodes with {steps}, {loaded.left_out} left out"
    named = options.task_argument or str(options.task or task.name)
    words = ["goalward", "train", named, "--demonstrations", str(options.out)]
    command = shlex.join([*words, "--set", f"demonstrations.episodes={count}"])
    return f"{options.out}: {counts}; next: {command}"


def _info(path: Path, *, as_json: bool) -> str:
    found = read(path)
    if not found.episodes:
        raise Error(f"{path}: expected an episode or more, found none")
    count, task = len(found.episodes), found.task
    lengths = [len(np.asarray(episode.observations)) - 1 for episode in found.episodes]
    with_actions = found.episodes[0].actions is not None
    if as_json:
        figures = {
            "file": str(path),
            "task": task.name,
            "episodes": count,
            "steps": sum(lengths),
            "steps_of_shortest": min(lengths),
            "steps_of_longest": max(lengths),
            "observation_shape": list(task.observation.shape),
            "actions": with_actions,
        }
        return json.dumps(figures, indent=2)
    actions = "with actions" if with_actions else "states only"
    shape = " x ".join(map(str, task.observation.shape))
    steps = f"{sum(lengths)} steps ({min(lengths)} to {max(lengths)} each)"
    return f"{path}: {count} episodes of {task.name} with {steps}, observations of {shape}, {actions}"


def _steps(episodes: Sequence[Episode]) -> int:
    return sum(len(np.asarray(episode.observations)) - 1 for episode in episodes)


if __name__ == "__main__":
    sys.exit(main())
