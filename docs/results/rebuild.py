"""Rebuilds the tables of the pages from the results' data, so that text and data cannot differ.

    python docs/results/rebuild.py                      # writes the tables
    python docs/results/rebuild.py --check              # says which page differs from the data
    python docs/results/rebuild.py --from REPORT        # takes the data and pictures of `goalward report` first

A table stands between `<!-- table: KIND ARGUMENT... -->` and `<!-- end of table -->`:

| kind | arguments | what it shows |
|---|---|---|
| `panel` | figure, panel | a row for each method, with every seed and the steps to 90 % |
| `overview` | figure/panel... | methods x panels, means with intervals; "of 3": of fewer seeds than the plan has |

Data: `runs.csv`, a line for each run; `curves.csv`, one for each method of a panel; `points.csv`, twenty points of
each run.
"""

import argparse
import csv
import re
import shutil
import statistics
import sys
from collections.abc import Callable, Iterable
from pathlib import Path

HERE = Path(__file__).resolve().parent
PAGES = [*sorted(HERE.glob("*.md")), HERE.parents[1] / "README.md"]
TABLE = re.compile(r"(<!-- table: (.*?) -->\n)(.*?)(<!-- end of table -->)", re.DOTALL)
POINTS_OF_A_RUN = 20
# Data has four decimals.
TOLERANCE = 0.0001

Row = dict[str, str]


def read(name: str) -> list[Row]:
    """The rows of a file of the data."""
    with (HERE / name).open(newline="") as file:
        return list(csv.DictReader(file))


def write(name: str, rows: Iterable[Row]) -> None:
    """Writes a file of the data."""
    rows = list(rows)
    with (HERE / name).open("w", newline="") as file:
        lines = csv.DictWriter(file, rows[0].keys(), lineterminator="\n")
        lines.writeheader()
        lines.writerows(rows)


def take(report: Path) -> None:
    """Takes over what a report has written."""

    def rows(name: str) -> list[Row]:
        with (report / name).open(newline="") as file:
            return [row | {"run": Path(row["run"]).name} if "run" in row else row for row in csv.DictReader(file)]

    write("runs.csv", rows("summary.csv"))
    write("curves.csv", rows("curves.csv"))
    write("points.csv", thinned(rows("results.csv")))
    shown = "".join(page.read_text() for page in PAGES)
    for picture in report.glob("*.svg"):
        if picture.name in shown:
            shutil.copy(picture, HERE / picture.name)


def thinned(points: list[Row]) -> Iterable[Row]:
    """Of each run the points where another twentieth of its steps was taken."""
    ends = {point["run"]: int(point["environment_steps"]) for point in points}
    taken: dict[str, int] = {}
    for point in points:
        run = point["run"]
        share = int(point["environment_steps"]) * POINTS_OF_A_RUN // max(ends[run], 1)
        if share > taken.get(run, 0):
            taken[run] = share
            yield point


def place(row: Row) -> tuple[str, str, str]:
    """What a curve and its runs have in common."""
    return row["figure"], row["panel"], row["curve"]


def evaluated() -> dict[tuple[str, str, str], list[Row]]:
    """The finished runs of each curve, by seed."""
    found: dict[tuple[str, str, str], list[Row]] = {}
    for run in sorted(read("runs.csv"), key=lambda run: int(run["seed"])):
        if run["evaluation_success_rate"]:
            found.setdefault(place(run), []).append(run)
    return found


def curves() -> list[Row]:
    """The curves that have finished runs."""
    return [row for row in read("curves.csv") if row["evaluation"]]


def disagreements() -> Iterable[str]:
    """Means that are not those of the runs."""
    found = evaluated()
    for curve in curves():
        rates = [float(run["evaluation_success_rate"]) for run in found.get(place(curve), [])]
        mean = statistics.mean(rates or [float("nan")])
        if not abs(mean - float(curve["evaluation"])) <= TOLERANCE:
            yield f"{' '.join(place(curve))}: expected the mean of the runs, {mean:.4f}, found {curve['evaluation']}"


def percent(share: str) -> str:
    """A share in per cent."""
    return f"{100 * float(share):.1f}" if share else "-"


def bounded(row: Row, name: str) -> str:
    """A mean with its 95 % interval."""
    if not row[f"{name}_low"]:
        return percent(row[name])
    return f"{percent(row[name])} ({percent(row[f'{name}_low'])} to {percent(row[f'{name}_high'])})"


def steps_to_90(runs: list[Row]) -> str:
    """Thousands of steps to 90 % success for good, the median of all seeds; none where half of them never get there."""
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
    found = evaluated()
    text = head(["method", "evaluation", "of each seed", "last 100", "steps to 90 %", "against the first", "authors"])
    for curve in curves():
        if place(curve)[:2] == (figure, name):
            runs = found[place(curve)]
            seeds = ", ".join(percent(run["evaluation_success_rate"]) for run in runs)
            standing, authors = curve["against_the_first"] or "-", curve["authors"]
            authors = f"{100 * float(authors):.0f}" if authors else "-"
            cells = [f"`{curve['curve']}`", f"**{bounded(curve, 'evaluation')}**", seeds]
            text += line([*cells, percent(curve["success_rate"]), steps_to_90(runs), standing, authors])
    return text


def overview(*panels: str) -> str:
    """Methods x panels; those that are ahead of or behind the first are marked."""
    cells = {(f"{row['figure']}/{row['panel']}", row["curve"]): row for row in curves()}
    methods = list(dict.fromkeys(curve for panel, curve in cells if panel in panels))
    text = head(["", *(panel.partition("/")[2] for panel in panels)])
    for method in methods:
        found = [cells.get((panel, method)) for panel in panels]
        shown = [cell(row) if row else "-" for row in found]
        text += line([f"`{method}`", *shown])
    return text


def cell(row: Row) -> str:
    """A curve in the overview."""
    marks = {"ahead": " ▲", "behind": " ▼"}
    missing = f" of {row['seeds']}" if row["seeds"] != row["of_seeds"] else ""
    return bounded(row, "evaluation") + marks.get(row["against_the_first"], "") + missing


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
    parser.add_argument("--check", action="store_true", help="write nothing; exit with 1 where a page differs")
    parser.add_argument("--from", dest="report", type=Path, metavar="REPORT", help="folder of a report to take")
    options = parser.parse_args()
    if options.report:
        take(options.report)
    wrong = list(disagreements())
    for page in PAGES:
        text = page.read_text()
        new = rebuilt(text)
        if new != text and options.check:
            wrong.append(f"{page}: expected the tables that the data gives; rebuild.py writes them")
        elif new != text:
            page.write_text(new)
    print("".join(f"{message}\n" for message in wrong), end="", file=sys.stderr)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
