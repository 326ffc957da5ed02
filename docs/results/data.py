"""The results' data: the plans in `deploy/experiments`, and the finished runs of `runs.csv` as their curves.

A run that several panels show needs to exist only once: a curve has the runs with its settings, whichever
panel they were trained for.
"""

import csv
import sys
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import NamedTuple

import tomllib
from estimates import standing
from settings import REPOSITORY, Settings, resolved

HERE = Path(__file__).resolve().parent
GUIDE = REPOSITORY / "docs/guide/src"
PAGES = [*sorted(HERE.glob("*.md")), REPOSITORY / "README.md", *sorted(GUIDE.glob("*.md"))]
# Panels of the table and the picture with which the results begin.
OPENING = [
    ("figure3", "navigation-50"),
    ("figure3", "push-noise-2"),
    ("figure3", "pick-50"),
    ("figure9", "pick-noise-2"),
    ("figure3", "ant-noise-0.05"),
]
# Runs with lower seeds are results; those from this seed on were trained to choose settings.
FIRST_TUNING_SEED = 101
RUNS, REPLAYS = HERE / "runs.csv", HERE / "replays.csv"

Row = dict[str, str]
# A value for each seed.
Seeds = dict[str, float]


class PlannedCurve(NamedTuple):
    """The plan of a curve."""

    # Everything that decides a run's result, except its seed.
    settings: Settings
    # The end of the authors' published curve.
    authors: float | None


class Plan(NamedTuple):
    """The plan of a panel."""

    title: str
    seeds: list[int]
    # In the order of the plan.
    curves: dict[str, PlannedCurve]


class Curve(NamedTuple):
    """A curve with its finished runs."""

    name: str
    runs: list[Row]
    evaluations: Seeds
    wanted: int
    authors: float | None
    against_the_first: str = ""

    @property
    def rates(self) -> list[float]:
        """The evaluated success rates."""
        return list(self.evaluations.values())


def read(file: Path) -> list[Row]:
    """Reads the rows of a table."""
    with file.open(newline="") as lines:
        return list(csv.DictReader(lines))


def write(file: Path, rows: list[Row]) -> None:
    """Writes a table, whose rows must have the same columns."""
    columns = rows[0].keys()
    for row in rows:
        if row.keys() != columns:
            found = ", ".join(row.keys() ^ columns)
            sys.exit(f"{file}: expected rows with the same columns, found some without {found}")
    with file.open("w", newline="") as target:
        lines = csv.DictWriter(target, columns, lineterminator="\n")
        lines.writeheader()
        lines.writerows(rows)


@cache
def plans() -> dict[tuple[str, str], Plan]:
    """Returns all panels by figure and name, in order."""
    found = {}
    files = (REPOSITORY / "deploy/experiments").glob("*.toml")
    # Figure 11 comes after Figure 9.
    for file in sorted(files, key=lambda file: (len(file.stem), file.stem)):
        plan = tomllib.loads(file.read_text())
        for panel in plan["panel"]:
            found[file.stem, panel["name"]] = Plan(panel["title"], plan["seeds"], planned(plan, panel))
    return found


def planned(plan: dict, panel: dict) -> dict[str, PlannedCurve]:
    """Returns the curves of a panel: its methods, then those with their own settings."""
    anchors, methods = panel.get("anchors", {}), panel.get("methods", plan.get("methods", []))
    entries = [{"name": method, "method": method, "anchor": anchors.get(method)} for method in methods]
    shared = [f"steps={panel['steps']}"] if "steps" in panel else []
    shared += plan.get("set", []) + panel.get("set", [])
    found = {}
    for entry in [*entries, *panel.get("curve", [])]:
        preset = entry.get("preset", panel.get("preset"))
        settings = resolved(panel["task"], preset, entry["method"], [*shared, *entry.get("set", [])])
        found[entry["name"]] = PlannedCurve(settings, entry.get("anchor"))
    return found


def key(row: Row) -> tuple[str, ...]:
    """Returns what identifies a row."""
    return row["figure"], row["panel"], row["curve"], row["seed"]


@cache
def order() -> dict[tuple[str, ...], int]:
    """Returns the position of each run in the order of the plans."""
    runs = (
        (*panel, curve, str(seed))
        for panel, plan in plans().items()
        for curve in plan.curves
        for seed in plan.seeds
    )
    return {run: place for place, run in enumerate(runs)}


def refuse_strays(file: Path, runs: Iterable[Row]) -> None:
    """Exits if runs are outside the plans, or have other numbers of evaluation episodes, as of `--quick`."""
    for run in runs:
        if key(run) not in order():
            sys.exit(f"{file}: expected runs of the plans in deploy/experiments, found {' '.join(key(run))}")
        wanted = dict(identity(run)[0])["evaluation.episodes"]
        episodes = run["evaluation_episodes"] or "none"
        if episodes != str(wanted):
            name = " ".join(key(run))
            sys.exit(f"{file}: {name}: expected an evaluation of {wanted} episodes, found {episodes}")


@cache
def finished() -> dict[tuple[Settings, int], list[Row]]:
    """Returns the runs by settings and seed; exits if repeated runs have different weights."""
    found: dict[tuple[Settings, int], list[Row]] = {}
    for run in read(RUNS):
        known = found.setdefault(identity(run), [])
        known.append(run)
        if weights(known[0]) != weights(run):
            first, other = (" ".join(key(row)) for row in (known[0], run))
            sys.exit(f"{RUNS}: expected {other} to have the hashes of {first}, found others")
    return found


def identity(run: Row) -> tuple[Settings, int]:
    """Returns the settings and seed that decide a run's result."""
    return plans()[run["figure"], run["panel"]].curves[run["curve"]].settings, int(run["seed"])


def weights(run: Row) -> tuple[str, str]:
    """Returns the hashes of a run's final weights."""
    return run["policy_sha256"], run["reward_model_sha256"]


def rates(runs: list[Row], name: str) -> Seeds:
    """Returns the values of a column by seed, for the runs that have one."""
    return {run["seed"]: float(run[name]) for run in runs if run[name]}


def replayed(curve: Curve) -> dict[str, Row]:
    """Returns the replays of a curve by seed, one of each, even if the seed was trained more than once."""
    runs = (same for run in curve.runs for same in finished()[identity(run)])
    named = ((run["seed"], (run["run"], run["policy_sha256"])) for run in runs)
    return {seed: replays()[name] for seed, name in named if name in replays()}


@cache
def replays() -> dict[tuple[str, str], Row]:
    """Returns all replays by the names and hashes of their runs."""
    return {(row["run"], row["policy_sha256"]): row for row in read(REPLAYS)}


@cache
def curves(figure: str, panel: str) -> list[Curve]:
    """Returns the curves of a panel that have evaluated runs."""
    plan = plans()[figure, panel]
    found = []
    for name, wanted in plan.curves.items():
        runs = [run for seed in plan.seeds for run in finished().get((wanted.settings, seed), [])[:1]]
        evaluations = rates(runs, "evaluation_success_rate")
        found.append(Curve(name, runs, evaluations, len(plan.seeds), wanted.authors))
    first, *others = found
    compared = (curve._replace(against_the_first=standing(curve.rates, first.rates)) for curve in others)
    return [curve for curve in (first, *compared) if curve.evaluations]
