"""Rebuilds the tables of the pages from the results' data, so that text and data cannot differ.

    pip install -r docs/results/requirements.txt
    python docs/results/rebuild.py                      # writes the tables
    python docs/results/rebuild.py --check              # says which page differs from the data
    python docs/results/rebuild.py --from REPORT        # takes the finished runs of `goalward report` first

A table stands between `<!-- table: KIND ARGUMENT... -->` and `<!-- end of table -->`:

| kind | arguments | what it shows |
|---|---|---|
| `panel` | figure, panel | a row for each method, with every seed and the steps to 90 % |
| `overview` | figure/panel... | methods x panels, means with intervals; "of 3": fewer seeds than planned |

Data: `runs.csv`, a line for each finished run; `points.csv`, twenty points of each. A report's runs take the
places of those of the same curves and seeds; all others stay, so runs may come in portions. The plans in
`deploy/experiments` have the order of the curves, the seeds that are wanted and the authors' numbers. Means,
intervals and comparisons are those of `deploy/report/src/statistics.rs`.
"""

import argparse
import csv
import re
import statistics
import sys
from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import tomllib
from scipy.stats import sem, t

HERE = Path(__file__).resolve().parent
REPOSITORY = HERE.parents[1]
PAGES = [*sorted(HERE.glob("*.md")), REPOSITORY / "README.md"]
TABLE = re.compile(r"(<!-- table: (.*?) -->\n)(.*?)(<!-- end of table -->)", re.DOTALL)
POINTS_OF_A_RUN = 20
# Fewest seeds that have an interval, and where the upper end of a 95 % interval lies.
FEWEST = 3
UPPER = 0.975

Row = dict[str, str]


class Plan(NamedTuple):
    """What a panel is to have."""

    title: str
    seeds: list[int]
    # The curves, in their order, with the end of the authors' published one.
    authors: dict[str, float | None]


class Curve(NamedTuple):
    """A curve with its finished runs."""

    name: str
    runs: list[Row]
    evaluations: list[float]
    wanted: int
    authors: float | None
    against_the_first: str = ""


def read(file: Path) -> list[Row]:
    """The rows of a table; runs are named by the last part of their path."""
    with file.open(newline="") as lines:
        return [row | {"run": Path(row["run"]).name} for row in csv.DictReader(lines)]


def write(file: Path, rows: list[Row]) -> None:
    """Writes a table."""
    with file.open("w", newline="") as target:
        lines = csv.DictWriter(target, rows[0].keys(), lineterminator="\n")
        lines.writeheader()
        lines.writerows(rows)


@cache
def plans() -> dict[tuple[str, str], Plan]:
    """All panels by figure and name, in their order."""
    found = {}
    files = (REPOSITORY / "deploy/experiments").glob("*.toml")
    # Figure 11 comes behind Figure 9.
    for file in sorted(files, key=lambda file: (len(file.stem), file.stem)):
        plan = tomllib.loads(file.read_text())
        for panel in plan["panel"]:
            methods = panel.get("methods", plan.get("methods", []))
            authors = {method: panel.get("anchors", {}).get(method) for method in methods}
            authors |= {curve["name"]: curve.get("anchor") for curve in panel.get("curve", [])}
            found[file.stem, panel["name"]] = Plan(panel["title"], plan["seeds"], authors)
    return found


def key(row: Row) -> tuple[str, ...]:
    """What tells a run from all others."""
    return row["figure"], row["panel"], row["curve"], row["seed"]


@cache
def order() -> dict[tuple[str, ...], int]:
    """The place of each run that the plans want."""
    runs = (
        (*panel, curve, str(seed))
        for panel, plan in plans().items()
        for curve in plan.authors
        for seed in plan.seeds
    )
    return {run: place for place, run in enumerate(runs)}


def refuse_strays(file: Path, runs: Iterable[Row]) -> None:
    """Ends the command where there are runs that no plan wants: no table would show them."""
    for run in runs:
        if key(run) not in order():
            sys.exit(f"{file}: expected runs of the plans in deploy/experiments, found {' '.join(key(run))}")


def take(report: Path) -> None:
    """Puts a report's finished runs in the places of those of the same curves and seeds."""
    summary = report / "summary.csv"
    runs = {key(run): run for run in read(summary) if run["finished"] == "1"}
    refuse_strays(summary, runs.values())
    points = (point for point in read(report / "results.csv") if key(point) in runs)
    for file, rows in ((HERE / "runs.csv", runs.values()), (HERE / "points.csv", thinned(list(points)))):
        others = (row for row in read(file) if key(row) not in runs)
        write(file, sorted([*others, *rows], key=lambda row: order()[key(row)]))


def thinned(points: list[Row]) -> Iterable[Row]:
    """Of each run the points where another twentieth of its steps was taken."""
    ends = {key(point): int(point["environment_steps"]) for point in points}
    taken: dict[tuple[str, ...], int] = {}
    for point in points:
        run = key(point)
        share = int(point["environment_steps"]) * POINTS_OF_A_RUN // max(ends[run], 1)
        if share > taken.get(run, 0):
            taken[run] = share
            yield point


def interval(shares: list[float] | np.ndarray) -> np.ndarray | None:
    """The ends of the 95 % interval of a mean over seeds, by Student's distribution; none of too few."""
    if len(shares) < FEWEST:
        return None
    mean, half = np.mean(shares, axis=0), t.ppf(UPPER, len(shares) - 1) * sem(shares)
    return np.clip([mean - half, mean + half], 0, 1)


def standing(curve: Curve, first: Curve) -> str:
    """How a curve stands to another, by Welch's 95 % interval of the difference of their means."""
    groups = curve.evaluations, first.evaluations
    if curve is first or min(map(len, groups)) < FEWEST:
        return ""
    errors = [sem(shares) ** 2 for shares in groups]
    freedoms = [error**2 / (len(shares) - 1) for error, shares in zip(errors, groups, strict=True)]
    # Seeds that all agree have no deviation, and no degrees of freedom.
    half = t.ppf(UPPER, sum(errors) ** 2 / sum(freedoms)) * sum(errors) ** 0.5 if any(errors) else 0.0
    difference = np.mean(groups[0]) - np.mean(groups[1])
    if abs(difference) <= half:
        return "not told apart"
    return "ahead" if difference > 0 else "behind"


@cache
def finished() -> dict[tuple[str, ...], list[Row]]:
    """The runs of each curve."""
    found: dict[tuple[str, ...], list[Row]] = {}
    for run in read(HERE / "runs.csv"):
        found.setdefault(key(run)[:3], []).append(run)
    return found


def rates(runs: list[Row], name: str) -> list[float]:
    """Success rates of the runs that have one."""
    return [float(run[name]) for run in runs if run[name]]


def curves(figure: str, panel: str) -> list[Curve]:
    """The curves of a panel whose runs have been evaluated."""
    plan = plans()[figure, panel]
    found = []
    for name, authors in plan.authors.items():
        runs = finished().get((figure, panel, name), [])
        evaluations = rates(runs, "evaluation_success_rate")
        found.append(Curve(name, runs, evaluations, len(plan.seeds), authors))
    first = found[0]
    compared = (curve._replace(against_the_first=standing(curve, first)) for curve in found)
    return [curve for curve in compared if curve.evaluations]


def percent(share: float) -> str:
    """A share in per cent."""
    return f"{100 * share:.1f}"


def bounded(shares: list[float]) -> str:
    """A mean with its 95 % interval."""
    ends = interval(shares)
    mean = percent(statistics.mean(shares))
    return mean if ends is None else f"{mean} ({percent(ends[0])} to {percent(ends[1])})"


def steps_to_90(runs: list[Row]) -> str:
    """Thousands of steps to 90 % success for good, median of the seeds; none where half never get there."""
    taken = [float(run["environment_steps_to_90"] or "inf") / 1000 for run in runs]
    median = statistics.median(taken)
    return f"{median:.0f}" if median < float("inf") else "-"


def line(cells: Iterable[str]) -> str:
    """A row of a table."""
    return f"| {' | '.join(cells)} |\n"


def head(cells: list[str]) -> str:
    """The head of a table."""
    return line(cells) + "|" + "---|" * len(cells) + "\n"


def panel(figure: str, name: str) -> str:
    """A row for each method of a panel, with every seed."""
    text = head(
        ["method", "evaluation", "of each seed", "last 100", "steps to 90 %", "against the first", "authors"]
    )
    for curve in curves(figure, name):
        seeds = ", ".join(percent(rate) for rate in curve.evaluations)
        trained = rates(curve.runs, "success_rate")
        last = percent(statistics.mean(trained)) if trained else "-"
        authors = "-" if curve.authors is None else f"{100 * curve.authors:.0f}"
        cells = [f"`{curve.name}`", f"**{bounded(curve.evaluations)}**", seeds, last, steps_to_90(curve.runs)]
        text += line([*cells, curve.against_the_first or "-", authors])
    return text


def overview(*panels: str) -> str:
    """Methods x panels; those that are ahead of or behind the first are marked."""
    columns = [{curve.name: cell(curve) for curve in curves(*panel.split("/"))} for panel in panels]
    text = head(["", *(panel.partition("/")[2] for panel in panels)])
    for method in dict.fromkeys(name for column in columns for name in column):
        text += line([f"`{method}`", *(column.get(method, "-") for column in columns)])
    return text


def cell(curve: Curve) -> str:
    """A curve in the overview."""
    marks = {"ahead": " ▲", "behind": " ▼"}
    missing = f" of {len(curve.runs)}" if len(curve.runs) < curve.wanted else ""
    return bounded(curve.evaluations) + marks.get(curve.against_the_first, "") + missing


KINDS: dict[str, Callable[..., str]] = {"panel": panel, "overview": overview}


def rebuilt(text: str) -> str:
    """A page with the tables that the data gives."""

    def table(found: re.Match[str]) -> str:
        kind, *arguments = found[2].split()
        return f"{found[1]}{KINDS[kind](*arguments)}{found[4]}"

    return TABLE.sub(table, text)


def main() -> int:
    """The command; 1 where a page differs."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true", help="write nothing; 1 where a page differs")
    parser.add_argument("--from", dest="report", type=Path, metavar="REPORT", help="a report to take")
    options = parser.parse_args()
    refuse_strays(HERE / "runs.csv", read(HERE / "runs.csv"))
    if options.report:
        take(options.report)
    status = 0
    for page in PAGES:
        text = page.read_text()
        new = rebuilt(text)
        if new != text and options.check:
            print(f"{page}: expected the tables that the data gives; rebuild.py writes them", file=sys.stderr)
            status = 1
        elif new != text:
            page.write_text(new)
    return status


if __name__ == "__main__":
    sys.exit(main())
