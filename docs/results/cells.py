"""Formats numbers for table cells and sentences, and joins cells to a table."""

import statistics
from collections.abc import Iterable

from estimates import Bounded, interval


def percent(share: float) -> str:
    """Formats a share in per cent, without a sign if it rounds to 0."""
    return f"{round(100 * share, 1) + 0.0:.1f}"


def mean_with_interval(shares: list[float], unit: str = "") -> str:
    """Formats a mean with its 95 % interval, in per cent."""
    mean, ends = statistics.mean(shares), interval(shares)
    return percent(mean) + unit if ends is None else within((mean, *ends), unit)


def within(found: Bounded, unit: str = "") -> str:
    """Formats a number with its interval, in per cent."""
    estimate, low, high = map(percent, found)
    return f"{estimate}{unit} ({low} to {high})"


def line(cells: Iterable[str]) -> str:
    """Returns a row of a table."""
    return f"| {' | '.join(cells)} |\n"


def head(cells: list[str]) -> str:
    """Returns the head of a table."""
    return line(cells) + "|" + "---|" * len(cells) + "\n"
