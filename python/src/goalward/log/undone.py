"""What a run undid: it went back to a checkpoint, and has not come as far again yet.

Iterations after the checkpoint are recorded again, and until then the old records of them would come ahead of
the iterations that they follow.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple


class Mark(NamedTuple):
    """A training trajectory or a policy update, which tell how far a run is."""

    log_time: int
    iteration: int
    is_update: bool


class Return(NamedTuple):
    """A run's going back: it did the iterations from this one on again, after this time."""

    log_time: int
    iteration: int

    def undoes(self, iteration: int, log_time: int) -> bool:
        """Whether a record of that time counts no more."""
        return iteration >= self.iteration and log_time < self.log_time


def returns(marks: Iterable[Mark]) -> list[Return]:
    """Every one, from the marks of all files."""
    found, learned = [], -1
    for mark in sorted(marks, key=lambda mark: mark.log_time):
        if mark.iteration <= learned:
            found.append(Return(mark.log_time, mark.iteration))
            learned = mark.iteration - 1
        if mark.is_update:
            learned = mark.iteration
    return found
