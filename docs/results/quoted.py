"""The kinds of numbers that sentences quote, each a function of the curves behind its name.

A curve is FIGURE/PANEL/CURVE; without figure and panel it is one of those of the curve before. Several curves
joined by `+` are one whose seeds have their means.
"""

import statistics
import sys
from collections.abc import Callable

from data import curves
from estimates import gain
from tables import bounded, percent, within

# Of each curve the evaluations of its seeds.
Evaluations = list[list[float]]


def evaluations(paths: list[str]) -> Evaluations:
    """The evaluations of curves."""
    found, place = [], ""
    for path in paths:
        before, _, names = path.rpartition("/")
        place = before or place
        figure, panel = place.split("/")
        of_panel = {curve.name: curve.evaluations for curve in curves(figure, panel)}
        missing = [name for name in names.split("+") if name not in of_panel]
        if missing:
            sys.exit(f"expected curves of {place} with finished runs, found {' '.join(missing)}")
        seeds = zip(*(of_panel[name] for name in names.split("+")), strict=True)
        found.append([statistics.mean(seed) for seed in seeds])
    return found


def mean(found: Evaluations) -> str:
    """Means: `98.5`, `98.5 and 96.8`."""
    return listed([percent(statistics.mean(seeds)) for seeds in found])


def success(found: Evaluations) -> str:
    """Means with their intervals: `95.8 % (93.9 to 97.7)`."""
    return listed([bounded(seeds).replace(" (", " % (") for seeds in found])


def seeds(found: Evaluations) -> str:
    """Every seed: `100.0, 100.0 and 33.4`."""
    return listed([percent(seed) for seeds in found for seed in seeds])


def span(found: Evaluations) -> str:
    """The lowest and the highest seed: `9.2 to 94.4`."""
    every = [seed for seeds in found for seed in seeds]
    return f"{percent(min(every))} to {percent(max(every))}"


def difference(found: Evaluations) -> str:
    """How much the first has more than the second, with Welch's interval: `13.3 (6.0 to 20.6)`."""
    own, others = found
    return within(gain(own, others))


def points(found: Evaluations) -> str:
    """The same with its unit: `13.3 points (6.0 to 20.6)`."""
    return difference(found).replace(" (", " points (")


def listed(words: list[str]) -> str:
    """Words as a sentence has them."""
    *others, last = words
    return f"{', '.join(others)} and {last}" if others else last


NUMBERS: dict[str, Callable[[Evaluations], str]] = {
    "mean": mean,
    "success": success,
    "seeds": seeds,
    "span": span,
    "difference": difference,
    "points": points,
}
