"""How numbers stand in the cells of tables and in sentences, and how cells make a table."""

import statistics
from collections.abc import Iterable

from estimates import Bounded, interval


def percent(share: float) -> str:
    """A share in per cent, without a sign where it rounds to 0."""
    return f"{round(100 * share, 1) + 0.0:.1f}"


def mean_with_interval(shares: list[float], unit: str = "") -> str:
    """A mean with its 95 % interval, per cent."""
    mean, ends = statistics.mean(shares), interval(shares)
    return percent(mean) + unit if ends is None else within((mean, *ends), unit)


def within(found: Bounded, unit: str = "") -> str:
    """A number with its interval, per cent."""
    estimate, low, high = map(percent, found)
    return f"{estimate}{unit} ({low} to {high})"


def line(cells: Iterable[str]) -> str:
    """A row of a table."""
    return f"| {' | '.join(cells)} |\n"


def head(cells: list[str]) -> str:
    """The head of a table."""
    return line(cells) + "|" + "---|" * len(cells) + "\n"
