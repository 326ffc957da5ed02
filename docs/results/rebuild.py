"""Rebuilds the tables and numbers of the pages from the results' data, so that text and data cannot differ.

    pip install -r docs/results/requirements.txt
    python docs/results/rebuild.py                      # writes them
    python docs/results/rebuild.py --check              # says which page differs from the data
    python docs/results/rebuild.py --from REPORT        # first takes the finished runs of `goalward report`

A table is between `<!-- table: KIND ARGUMENT... -->` and `<!-- end of table -->`:

| kind | arguments | what it shows |
|---|---|---|
| `panel` | figure, panel | a row for each method, with every seed and the steps to 90 % |
| `pivot` | name | the table that `pivots.toml` describes, from `settings.csv` or another file |
| `overview` | figure, or none | methods x its panels, or the opening ones; "of 3": fewer seeds than planned |
| `over` | | methods over the opening panels: interquartile mean and probability of improvement |
| `replays` | figure, panel | for each curve, the replayed seeds and the success of both ways to act |
| `search` | | the number of runs trained to choose settings, from `settings.csv` |
| `coverage` | | for each plan, the number of complete panels and of finished runs |
| `repeated` | | the number of runs that were trained more than once |

A number in a sentence is between `<!-- number: KIND CURVE... -->` and `<!-- end -->`; `quoted.py` has the
kinds and says how curves are named. The comment must not begin a line: Markdown would end the paragraph. In
the project's README and the results page, a rate with a decimal that is not between them is refused.

Data: `runs.csv` has a line for each finished run of the plans, and `points.csv` twenty points of each.
`replays.csv`, `uncertainty.csv` and `random_policy.csv` are written by the scripts of the same names.
`settings.csv` has runs outside the plans, with the settings in which they differ from the default at
their time, `mujoco_evaluations.csv` those of the examples in MuJoCo. A report's runs replace those of the
same curves and seeds; all others stay, so runs can be added in portions. The plans in
`deploy/experiments` have the order of the curves, the wanted seeds and the authors' numbers.
"""

import argparse
import re
import sys
from collections.abc import Iterable
from pathlib import Path

from data import HERE, PAGES, RUNS, Row, key, order, read, refuse_strays, write
from quoted import quoted
from tables import KINDS

NUMBER = re.compile(r"(?m)(^\s*)?(<!-- number: (\S+) (.*?) -->)(.*?)(<!-- end -->)")
TABLE = re.compile(r"(<!-- table: (.*?) -->\n)(.*?)(<!-- end of table -->)", re.DOTALL)
# A rate or a difference in a sentence, such as `98.5 and 96.8 %`, and text in which none is one.
RATE = re.compile(r"\d+\.\d(?:(?:, | and | to )\d+\.\d)* (?:%|points)")
CODE = re.compile(r"```.*?```|`[^`\n]*`", re.DOTALL)
# Pages in which every rate is between marks.
RESULTS = [HERE / "README.md", HERE.parents[1] / "README.md"]
POINTS_OF_A_RUN = 20


def take(report: Path) -> None:
    """Replaces the runs of the same curves and seeds with a report's finished runs."""
    summary = report / "summary.csv"
    runs = {key(run): run for run in reported(summary) if run["finished"] == "1"}
    refuse_strays(summary, runs.values())
    points = (point for point in reported(report / "results.csv") if key(point) in runs)
    for file, rows in ((RUNS, runs.values()), (HERE / "points.csv", thinned(list(points)))):
        others = (row for row in read(file) if key(row) not in runs)
        write(file, sorted([*others, *rows], key=lambda row: order()[key(row)]))


def reported(file: Path) -> list[Row]:
    """Reads the rows of a report's table; runs are named by the last part of their path."""
    return [row | {"run": Path(row["run"]).name} for row in read(file)]


def thinned(points: list[Row]) -> Iterable[Row]:
    """Yields each run's first point at or after every twentieth of its steps."""
    ends = {key(point): int(point["environment_steps"]) for point in points}
    taken: dict[tuple[str, ...], int] = {}
    for point in points:
        run = key(point)
        share = int(point["environment_steps"]) * POINTS_OF_A_RUN // max(ends[run], 1)
        if share > taken.get(run, 0):
            taken[run] = share
            yield point


def rebuilt(text: str) -> str:
    """Returns a page with the tables and numbers that follow from the data."""

    def number(found: re.Match[str]) -> str:
        if found[1] is not None:
            sys.exit(f"expected `{found[2]}` behind a word, found it at the beginning of a line")
        return f"{found[2]}{quoted(found[3], found[4].split())}{found[6]}"

    def table(found: re.Match[str]) -> str:
        kind, *arguments = found[2].split()
        return f"{found[1]}{KINDS[kind](*arguments)}{found[4]}"

    return NUMBER.sub(number, TABLE.sub(table, text))


def refuse_open_markers(page: Path, text: str) -> None:
    """Exits if a table or number in a page has a beginning without an end, or an end without a beginning."""
    for pattern, begin, end in (
        (TABLE, "<!-- table", "<!-- end of table -->"),
        (NUMBER, "<!-- number", "<!-- end -->"),
    ):
        found = len(pattern.findall(text)), text.count(begin), text.count(end)
        if len(set(found)) > 1:
            whole, begins, ends = found
            sys.exit(f"{page}: expected `{end}` for each `{begin}`, found {whole} of {begins} and {ends}")


def refuse_typed_rates(page: Path, text: str) -> None:
    """Exits if a page has a rate with a decimal that no data stands behind."""
    typed = RATE.search(CODE.sub("", NUMBER.sub("", TABLE.sub("", text))))
    if typed:
        sys.exit(f"{page}: expected `<!-- number: KIND CURVE... -->` before each rate, found {typed[0]}")


def main() -> int:
    """Runs the command; returns 1 with `--check` if a page differs."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    mode = parser.add_mutually_exclusive_group()
    mode.add_argument("--check", action="store_true", help="write nothing; 1 where a page differs")
    mode.add_argument("--from", dest="report", type=Path, metavar="REPORT", help="a report to take")
    options = parser.parse_args()
    refuse_strays(RUNS, read(RUNS))
    if options.report:
        take(options.report)
    status = 0
    for page in PAGES:
        text = page.read_text()
        refuse_open_markers(page, text)
        if page in RESULTS:
            refuse_typed_rates(page, text)
        new = rebuilt(text)
        if new != text and options.check:
            print(
                f"{page}: expected the tables and numbers that the data gives; rebuild.py writes them",
                file=sys.stderr,
            )
            status = 1
        elif new != text:
            page.write_text(new)
    return status


if __name__ == "__main__":
    sys.exit(main())
