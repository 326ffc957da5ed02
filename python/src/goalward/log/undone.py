"""Records that a run has undone by going back to a checkpoint, and has not made again yet.

The iterations after the checkpoint are recorded again. Until then, their old records would come before the
iterations that they follow.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple


class Mark(NamedTuple):
    """A training trajectory or a policy update, which shows how far a run is."""

    log_time: int
    iteration: int
    is_update: bool


class Return(NamedTuple):
    """A return to a checkpoint: from this time on, the run repeats the iterations from this one on."""

    log_time: int
    iteration: int

    def undoes(self, iteration: int, log_time: int) -> bool:
        """Return whether a record of this iteration and time is undone."""
        return iteration >= self.iteration and log_time < self.log_time


def returns(marks: Iterable[Mark]) -> list[Return]:
    """Find all returns to checkpoints, from the marks of all files."""
    found, learned = [], -1
    for mark in sorted(marks, key=lambda mark: mark.log_time):
        if mark.iteration <= learned:
            found.append(Return(mark.log_time, mark.iteration))
            learned = mark.iteration - 1
        if mark.is_update:
            learned = mark.iteration
    return found
