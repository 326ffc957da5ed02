"""Draws learning curves from the logs of runs, and keeps them as data.

Usage: curves.py OUT TITLE LABEL=RUN[,RUN...] [LABEL=FILE.csv:LABEL_THERE]...

It reads every RUN's log/updates-*.mcap with the public MCAP packages (requirements.txt beside this file) into
OUT.csv, one row per policy update. Rows that OUT.csv already has stay, unless a run with the same label and
seed replaces them. Then it draws all curves of OUT.csv, and those named in other tables, as OUT.svg: success
rate of the last 100 training episodes against environment steps and against wall time, with a thin line per
seed and a thick mean (published curves have no times). It prints the mean success rate around certain step
counts.
"""

import csv
import glob
import os
import sys

import matplotlib

matplotlib.use("svg")
import matplotlib.pyplot as plt
import numpy as np
from mcap.exceptions import EndOfFile
from mcap.reader import NonSeekingReader
from mcap_protobuf.decoder import DecoderFactory

COLUMNS = [
    "label",
    "seed",
    "iteration",
    "env_steps",
    "wall_s",
    "success_rate",
    "entropy",
    "approximate_kl",
    "mean_proximity",
    "mean_uncertainty",
]
PRINTED_STEPS = [0.25e6, 0.5e6, 1e6, 1.5e6, 2e6, 3e6, 4e6, 5e6]
WINDOW_STEPS = 50_000


def updates(run):
    """Returns the policy updates of a run in order; the last record of an iteration counts."""
    found = {}
    for path in sorted(glob.glob(f"{run}/log/updates-*.mcap*")):
        with open(path, "rb") as file:
            reader = NonSeekingReader(file, decoder_factories=[DecoderFactory()])
            try:
                for _, channel, message, update in reader.iter_decoded_messages(log_time_order=False):
                    if channel.topic == "/policy/update":
                        found[update.iteration] = (message.log_time, update)
            except EndOfFile:
                pass  # the file is still being written
    return [found[iteration] for iteration in sorted(found)]


def seed_of(run):
    with open(f"{run}/config.toml") as file:
        return next(line.split("=")[1].strip() for line in file if line.startswith("seed"))


def rows_of(label, run):
    """Yields a run as rows of the table."""
    recorded, seed = updates(run), seed_of(run)
    first_time, first = recorded[0]
    start = first_time - int(1e9 * (first.rollout_s + first.update_s))
    for time, u in recorded:
        yield [
            label,
            seed,
            u.iteration,
            u.environment_steps,
            f"{(time - start) / 1e9:.1f}",
            f"{u.success_rate:.2f}",
            f"{u.entropy:.4f}",
            f"{u.approximate_kl:.5f}",
            f"{u.mean_proximity:.4f}",
            f"{u.mean_uncertainty:.4f}",
        ]


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
    for color, label in zip(matplotlib.color_sequences["tab10"], labels):
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
    for label, sources in (group.split("=") for group in groups):
        if ".csv:" in sources:
            others |= beside(label, sources)
            continue
        for run in sources.split(","):
            curves[(label, seed_of(run))] = list(rows_of(label, run))
    write(f"{out}.csv", curves)
    curves |= others
    draw(f"{out}.svg", title, curves)
    print_table(curves)


if __name__ == "__main__":
    main()
