"""The kinds of tables in pages, each a function of the arguments after its name."""

import statistics
import sys
from collections import Counter
from collections.abc import Callable

from cells import head, line, mean_with_interval, percent, within
from data import (
    FIRST_TUNING_SEED,
    HERE,
    OPENING,
    RUNS,
    Curve,
    Plan,
    Row,
    curves,
    finished,
    plans,
    rates,
    read,
    replayed,
    weights,
)
from estimates import FEWEST, Bounded, improvement, interquartile_mean
from pivots import pivot
from settings import Settings


def steps_to_90(runs: list[Row]) -> str:
    """Returns the median over seeds of thousands of steps to 90 % success; `-` if half never reach it."""
    taken = [float(run["environment_steps_to_90"] or "inf") / 1000 for run in runs]
    median = statistics.median(taken)
    return f"{median:.0f}" if median < float("inf") else "-"


def panel(figure: str, name: str) -> str:
    """Makes a row for each method of a panel, with every seed."""
    text = head(
        ["method", "evaluation", "of each seed", "last 100", "steps to 90 %", "against the first", "authors"]
    )
    for curve in curves(figure, name):
        seeds = ", ".join(map(percent, curve.rates))
        trained = rates(curve.runs, "success_rate").values()
        last = percent(statistics.mean(trained)) if trained else "-"
        authors = "-" if curve.authors is None else f"{100 * curve.authors:.0f}"
        cells = [f"`{curve.name}`", f"**{mean_with_interval(curve.rates)}**", seeds, last]
        text += line([*cells, steps_to_90(curve.runs), curve.against_the_first or "-", authors])
    return text


def overview(figure: str = "") -> str:
    """Makes methods x panels of a figure, or the opening ones; marks: ahead of or behind the first method."""
    panels = [panel for panel in plans() if panel[0] == figure] if figure else OPENING
    if not panels:
        sys.exit(f"expected panels of {figure}, found none")
    columns = [{curve.name: cell(curve) for curve in curves(*panel)} for panel in panels]
    text = head(["", *(plans()[panel].title for panel in panels)])
    for method in dict.fromkeys(name for column in columns for name in column):
        text += line([f"`{method}`", *(column.get(method, "-") for column in columns)])
    return text


def cell(curve: Curve) -> str:
    """Formats a curve for the overview."""
    marks = {"ahead": " ▲", "behind": " ▼", "every seed above": " △", "every seed below": " ▽"}
    missing = f" of {len(curve.runs)}" if len(curve.runs) < curve.wanted else ""
    return mean_with_interval(curve.rates) + marks.get(curve.against_the_first, "") + missing


def over() -> str:
    """Compares the methods that all opening panels have with the first one, over all these panels."""
    columns = [
        {curve.name: curve.rates for curve in curves(*panel) if len(curve.rates) >= FEWEST}
        for panel in OPENING
    ]
    shared = [name for name in columns[0] if all(name in column for column in columns)]
    scores = {name: [column[name] for column in columns] for name in shared}
    first = shared[0]
    text = head(["", "mean", "interquartile mean", f"better than `{first}`"])
    for name in shared:
        means = percent(statistics.mean(map(statistics.mean, scores[name])))
        better = improvement(scores[name], scores[first])
        last = "-" if name == first else within(better) + mark(better)
        text += line([f"`{name}`", means, within(interquartile_mean(scores[name])), last])
    return text


def mark(probability: Bounded) -> str:
    """Marks a probability whose interval is above or below one half."""
    _, low, high = probability
    return " ▲" if low > 0.5 else " ▼" if high < 0.5 else ""


def replays(figure: str, panel: str) -> str:
    """Shows for each curve the replayed seeds and the success of both ways to act."""
    text = head(["method", "seeds acted again", "seeds trained again", "sampled", "most probable"])
    for curve in curves(figure, panel):
        rows = list(replayed(curve).items())
        cells = [seeds(rows, column) for column in ("verified", "retrained")]
        cells += [mean(rows, column) for column in ("sampled", "most_probable")]
        text += line([f"`{curve.name}`", *cells])
    return text


def coverage() -> str:
    """Counts for each plan the panels that have all their runs, and the finished runs."""
    text = head(["plan", "complete panels", "runs"])
    for figure in dict.fromkeys(figure for figure, _ in plans()):
        panels = [runs_of(plan) for (name, _), plan in plans().items() if name == figure]
        complete = sum(panel <= finished().keys() for panel in panels)
        wanted = set().union(*panels)
        found = wanted & finished().keys()
        text += line([f"`{figure}`", f"{complete} of {len(panels)}", f"{len(found)} of {len(wanted)}"])
    return text


def runs_of(plan: Plan) -> set[tuple[Settings, int]]:
    """Returns the runs that a panel needs."""
    return {(curve.settings, seed) for curve in plan.curves.values() for seed in plan.seeds}


def search() -> str:
    """Counts the runs of each method that were trained to choose settings, by task."""
    runs = [run for run in read(HERE / "settings.csv") if int(run["seed"]) >= FIRST_TUNING_SEED]
    times = Counter((tuned(run), run["task"]) for run in runs)
    tasks, methods = sorted({task for _, task in times}), sorted({method for method, _ in times})
    text = head(["runs", *tasks])
    for method in methods:
        text += line([f"`{method}`", *(str(times[method, task] or "-") for task in tasks)])
    return text


def tuned(run: Row) -> str:
    """Returns the method whose settings a run was trained to choose."""
    return "soft-push-back" if "reward.agent_weight" in run["settings"] else run["method"]


def seeds(rows: list[tuple[str, Row]], column: str) -> str:
    """Lists the seeds whose runs have a value in a column."""
    return ", ".join(seed for seed, row in rows if row[column]) or "-"


def mean(rows: list[tuple[str, Row]], column: str) -> str:
    """Formats the mean of a column over the runs that have a value there."""
    found = [float(row[column]) for _, row in rows if row[column]]
    return mean_with_interval(found) if found else "-"


def repeated() -> str:
    """Counts runs that were trained more than once, by their weights; `bc`, without steps, is left out."""
    runs = [run for run in read(RUNS) if int(run["environment_steps"])]
    names: dict[tuple[str, str], set[str]] = {}
    for run in runs:
        names.setdefault(weights(run), set()).add(run["run"])
    again = sum(len(others) > 1 for others in names.values())
    return f"Of {len(names)} runs (without `bc`) {again} were trained more than once, to the same hashes.\n"


KINDS: dict[str, Callable[..., str]] = {
    "panel": panel,
    "pivot": pivot,
    "overview": overview,
    "over": over,
    "replays": replays,
    "repeated": repeated,
    "search": search,
    "coverage": coverage,
}
