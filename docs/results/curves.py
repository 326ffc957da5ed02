"""Draws learning curves from the logs of runs, and keeps them as data.

Usage: curves.py OUT TITLE LABEL=RUN[,RUN...] [LABEL=FILE.csv:LABEL_THERE]...

    pip install -r docs/results/requirements.txt ./python

It reads the logs of all runs into OUT.csv, one row per policy update. Rows that OUT.csv already has stay,
unless a run with the same label and seed replaces them. Then it draws all curves of OUT.csv, and those named
in other tables, as OUT.svg: success rate of the last 100 training episodes against environment steps and
against wall time, with a thin line per seed and a thick mean (published curves have no times). It prints the
mean success rate around certain step counts.
"""

import csv
import os
import sys
from itertools import cycle

import matplotlib

matplotlib.use("svg")
import matplotlib.pyplot as plt
import numpy as np

from goalward.log import Log

# The columns that a log fills, and their decimal places.
DIGITS = {
    "iteration": 0,
    "env_steps": 0,
    "wall_s": 1,
    "success_rate": 2,
    "entropy": 4,
    "approximate_kl": 5,
    "mean_proximity": 4,
    "mean_uncertainty": 4,
}
COLUMNS = ["label", "seed", *DIGITS]
PRINTED_STEPS = [0.25e6, 0.5e6, 1e6, 1.5e6, 2e6, 3e6, 4e6, 5e6]
WINDOW_STEPS = 50_000


def rows_of(label, seed, updates):
    """Yields the policy updates of a run as rows of the table."""
    # `wall_s` of a log includes offline training; a curve begins with the first rollout.
    start = updates["wall_s"][0] - sum(updates[part][0] for part in ("rollout_s", "scoring_s", "update_s"))
    own = updates | {"env_steps": updates["environment_steps"], "wall_s": updates["wall_s"] - start}
    texts = ([f"{value:.{digits}f}" for value in own[name]] for name, digits in DIGITS.items())
    for values in zip(*texts):
        yield [label, seed, *values]


def read(path):
    """Reads curves by label and seed, each a list of rows."""
    curves = {}
    if os.path.exists(path):
        with open(path, newline="") as file:
            for row in list(csv.reader(file))[1:]:
                curves.setdefault((row[0], row[1]), []).append(row)
    return curves


def write(path, curves):
    with open(path, "w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        for key in sorted(curves):
            writer.writerows(curves[key])


def column(rows, name):
    return np.array([float(row[COLUMNS.index(name)]) for row in rows])


def beside(label, source):
    """Reads curves of another table, under a label of this picture."""
    path, there = source.rsplit(":", 1)
    found = {(label, seed): rows for (own, seed), rows in read(path).items() if own == there}
    if not found:
        sys.exit(f"expected curves of {there} in {path}, found none")
    return found


def draw(path, title, curves):
    figure, (by_steps, by_time) = plt.subplots(1, 2, figsize=(10, 5), sharey=True, layout="constrained")
    labels = sorted({label for label, _ in curves})
    for color, label in zip(cycle(matplotlib.color_sequences["tab10"]), labels, strict=False):
        draw_label(
            by_steps,
            by_time,
            color,
            label,
            {seed: rows for (own, seed), rows in sorted(curves.items()) if own == label},
        )
    by_steps.set_xlabel("environment steps, millions")
    by_time.set_xlabel("wall time, minutes")
    by_steps.set_ylabel("success, last 100 training episodes")
    for axes in (by_steps, by_time):
        axes.set_ylim(0, 1.02)
        axes.grid(alpha=0.3)
    figure.suptitle(title)
    figure.legend(loc="outside lower center", ncols=3)
    figure.savefig(path)


def draw_label(by_steps, by_time, color, label, seeds):
    """Draws the curves of a label by seed; a published curve has the seed `mean of N` and no times."""
    for rows in seeds.values():
        success = column(rows, "success_rate")
        by_steps.plot(column(rows, "env_steps") / 1e6, success, color=color, alpha=0.35, lw=0.8)
        if rows[0][COLUMNS.index("wall_s")]:
            by_time.plot(column(rows, "wall_s") / 60, success, color=color, alpha=0.6, lw=0.8)
    first = max(column(rows, "env_steps")[0] for rows in seeds.values())
    last = min(column(rows, "env_steps")[-1] for rows in seeds.values())
    common = np.arange(first, last + 1, 10_000)
    mean = np.mean(
        [
            np.interp(common, column(rows, "env_steps"), column(rows, "success_rate"))
            for rows in seeds.values()
        ],
        axis=0,
    )
    only = next(iter(seeds))
    count = only if only.startswith("mean") else f"{len(seeds)} seed{'s' if len(seeds) > 1 else ''}"
    by_steps.plot(common / 1e6, mean, color=color, lw=2, label=f"{label} ({count})")


def print_table(curves):
    print("label, seed".ljust(32), *(f"{steps / 1e6:>6.2f}" for steps in PRINTED_STEPS), "  last")
    for (label, seed), rows in sorted(curves.items()):
        steps, success = column(rows, "env_steps"), column(rows, "success_rate")
        near = [success[abs(steps - point) <= WINDOW_STEPS] for point in PRINTED_STEPS]
        reached = [f"{100 * part.mean():6.0f}" if part.size else " " * 6 for part in near]
        print(f"{label}, {seed}".ljust(32), *reached, f"{100 * success[-1]:6.0f}")


def main():
    out, title, groups = sys.argv[1], sys.argv[2], sys.argv[3:]
    curves, others = read(f"{out}.csv"), {}
    for label, sources in (group.rsplit("=", 1) for group in groups):
        if ".csv:" in sources:
            others |= beside(label, sources)
            continue
        for run in sources.split(","):
            log = Log(run)
            seed = str(log.config["seed"])
            curves[(label, seed)] = list(rows_of(label, seed, log.updates()))
    write(f"{out}.csv", curves)
    curves |= others
    draw(f"{out}.svg", title, curves)
    print_table(curves)


if __name__ == "__main__":
    main()
