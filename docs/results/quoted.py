"""The kinds of numbers that sentences quote, each a function of the curves after its name.

A curve is FIGURE/PANEL/CURVE, or TABLE/COLUMN/ROW of `pivots.toml` or `quoted.toml`; the first two parts
may be left out if they are those of the curve before. CURVE:most-probable is the success of its replayed
policies with their most probable actions, CURVE@1,2 has only those seeds. Several curves joined by `+`
are one, whose values are their means by seed.
"""

import statistics
import sys
from collections.abc import Callable

from cells import mean_with_interval, percent, within
from data import Curve, Seeds, curves, replayed
from estimates import FEWEST, Bounded, gain, improvement, paired_gain
from pivots import PIVOTS, column


def evaluations(paths: list[str]) -> list[Seeds]:
    """Returns the evaluations of curves."""
    found, place = [], ""
    for path in paths:
        before, _, names = path.rpartition("/")
        place = before or place
        of_panel = known(*place.split("/"))
        found.append(together([of_seeds(of_panel, place, name) for name in names.split("+")]))
    return found


def of_seeds(of_panel: dict[str, Seeds], place: str, named: str) -> Seeds:
    """Returns a curve of a panel, or those of its seeds that are named behind an `@`."""
    name, _, wanted = named.partition("@")
    curve = of_panel.get(name, {})
    seeds = wanted.split(",") if wanted else list(curve)
    if not curve or not curve.keys() >= set(seeds):
        present = f"those of seeds {' '.join(curve)}" if curve else "none"
        sys.exit(f"expected finished runs of {place}/{named}, found {present}")
    return {seed: curve[seed] for seed in seeds}


def known(figure: str, panel: str) -> dict[str, Seeds]:
    """Returns the evaluations of all curves of a panel, or of all rows in a column."""
    if figure in PIVOTS:
        return column(figure, panel)
    found = {}
    for curve in curves(figure, panel):
        found[curve.name] = curve.evaluations
        found[f"{curve.name}:most-probable"] = most_probable(curve)
    return found


def most_probable(curve: Curve) -> Seeds:
    """Returns the success of a curve's replayed policies with their most probable actions."""
    found = replayed(curve)
    return {seed: float(row["most_probable"]) for seed, row in found.items() if row["most_probable"]}


def together(found: list[Seeds]) -> Seeds:
    """Returns the means of several curves by seed."""
    same_seeds(found)
    return {seed: statistics.mean(curve[seed] for curve in found) for seed in found[0]}


def same_seeds(found: list[Seeds]) -> None:
    """Exits if curves have other seeds than the first one."""
    for curve in found:
        if curve.keys() != found[0].keys():
            sys.exit(f"expected the seeds {' '.join(found[0])}, found {' '.join(curve)}")


def mean(found: list[Seeds]) -> str:
    """Lists means: `98.5`, `98.5 and 96.8`."""
    return listed([percent(statistics.mean(curve.values())) for curve in found])


def success(found: list[Seeds]) -> str:
    """Lists means with intervals: `95.8 % (93.9 to 97.7)`."""
    return listed([mean_with_interval(list(curve.values()), " %") for curve in found])


def seeds(found: list[Seeds]) -> str:
    """Lists every seed: `100.0, 100.0 and 33.4`."""
    return listed([percent(rate) for curve in found for rate in curve.values()])


def span(found: list[Seeds]) -> str:
    """Formats the range of the seeds: `9.2 to 94.4`."""
    every = [rate for curve in found for rate in curve.values()]
    return f"{percent(min(every))} to {percent(max(every))}"


def below(found: list[Seeds], level: float) -> str:
    """Counts the seeds below a level in per cent: `9 of the 40`."""
    every = [rate for curve in found for rate in curve.values()]
    return f"{sum(round(100 * rate, 6) < level for rate in every)} of the {len(every)}"


def difference(found: list[Seeds]) -> str:
    """Formats by how much the first exceeds the second, with Welch's interval: `13.3 (6.0 to 20.6)`."""
    return within(compared(found, gain))


def points(found: list[Seeds]) -> str:
    """Formats a difference with its unit: `13.3 points (6.0 to 20.6)`."""
    return within(compared(found, gain), " points")


def paired(found: list[Seeds]) -> str:
    """Formats by how much the first exceeds the second, paired by seed: `3.9 points (0.9 to 6.9)`.

    Of four curves: by how much more the first exceeds the second than the third exceeds the fourth.
    """
    same_seeds(found)
    own, others, *rest = found
    if rest:
        third, fourth = rest
        others = {seed: others[seed] + third[seed] - fourth[seed] for seed in own}
    return within(compared([own, {seed: others[seed] for seed in own}], paired_gain), " points")


def compared(found: list[Seeds], how: Callable[[list[float], list[float]], Bounded]) -> Bounded:
    """Compares two curves; exits if one has too few seeds."""
    refuse_few(found)
    own, others = (list(curve.values()) for curve in found)
    return how(own, others)


def refuse_few(found: list[Seeds]) -> None:
    """Exits if a curve has too few seeds to be compared."""
    counts = [len(curve) for curve in found]
    if min(counts) < FEWEST:
        sys.exit(
            f"expected at least {FEWEST} seeds to compare, found {listed([str(count) for count in counts])}"
        )


def better(found: list[Seeds]) -> str:
    """Formats how probably a seed of the first half beats one of the second: `63.5 % (44.5 to 81.5)`."""
    refuse_few(found)
    panels = [list(curve.values()) for curve in found]
    half, rest = divmod(len(panels), 2)
    if rest:
        sys.exit(f"expected the same panels of two methods, found {len(panels)} curves")
    return within(improvement(panels[:half], panels[half:]), " %")


def times(found: list[Seeds]) -> str:
    """Lists the ratios of means, of the first curve to the second and so on, over shared seeds: `0.71`."""
    pairs = zip(found[::2], found[1::2], strict=True)
    return listed([f"{ratio(own, others):.2f}" for own, others in pairs])


def ratio(own: Seeds, others: Seeds) -> float:
    """Returns the ratio of the means of two curves over the seeds that both have."""
    shared = own.keys() & others.keys()
    return sum(own[seed] for seed in shared) / sum(others[seed] for seed in shared)


def listed(words: list[str]) -> str:
    """Joins words as in a sentence."""
    *others, last = words
    return f"{', '.join(others)} and {last}" if others else last


def quoted(kind: str, words: list[str]) -> str:
    """Returns the number of some curves; of `below`, a level comes before them: `below 85 CURVE...`."""
    if kind == "below":
        level, *paths = words
        return below(evaluations(paths), float(level))
    return NUMBERS[kind](evaluations(words))


NUMBERS: dict[str, Callable[[list[Seeds]], str]] = {
    "mean": mean,
    "success": success,
    "seeds": seeds,
    "span": span,
    "difference": difference,
    "points": points,
    "paired": paired,
    "better": better,
    "times": times,
}
