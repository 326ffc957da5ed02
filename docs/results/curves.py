"""Draws learning curves from the logs of runs, and keeps them as data.

Usage: curves.py OUT TITLE LABEL=RUN[,RUN...] [LABEL=RUN[,RUN...]]...

Reads every RUN's log/updates-*.mcap with the public MCAP packages (requirements.txt beside this
file), writes OUT.csv (one row per policy update) and OUT.svg (success rate of the last 100 training
episodes against environment steps and against wall time; a thin line per seed, a thick mean).
"""

import csv
import glob
import sys

import matplotlib

matplotlib.use("svg")
import matplotlib.pyplot as plt
import numpy as np
from mcap.exceptions import EndOfFile
from mcap.reader import NonSeekingReader
from mcap_protobuf.decoder import DecoderFactory


def updates(run):
    """The policy updates of a run in order, the later record of an iteration counting."""
    found = {}
    for path in sorted(glob.glob(f"{run}/log/updates-*.mcap*")):
        with open(path, "rb") as file:
            reader = NonSeekingReader(file, decoder_factories=[DecoderFactory()])
            try:
                for _, channel, message, update in reader.iter_decoded_messages(log_time_order=False):
                    if channel.topic == "/policy/update":
                        found[update.iteration] = (message.log_time, update)
            except EndOfFile:
                pass  # a file that is still being written
    return [found[iteration] for iteration in sorted(found)]


def seed_of(run):
    with open(f"{run}/config.toml") as file:
        return next(line.split("=")[1].strip() for line in file if line.startswith("seed"))


def main():
    out, title, groups = sys.argv[1], sys.argv[2], sys.argv[3:]
    figure, (by_steps, by_time) = plt.subplots(1, 2, figsize=(10, 4), sharey=True)
    with open(f"{out}.csv", "w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["label", "seed", "iteration", "env_steps", "wall_s", "success_rate",
                         "entropy", "approximate_kl", "mean_proximity", "mean_uncertainty"])
        for color, group in zip(["tab:blue", "tab:orange", "tab:green", "tab:red"], groups):
            label, runs = group.split("=")
            curves = []
            for run in runs.split(","):
                rows = updates(run)
                start = rows[0][0] - int(1e9 * (rows[0][1].rollout_s + rows[0][1].update_s))
                steps = np.array([update.environment_steps for _, update in rows])
                wall = np.array([(time - start) / 1e9 for time, _ in rows])
                success = np.array([update.success_rate for _, update in rows])
                for (_, u), seconds in zip(rows, wall):
                    writer.writerow([label, seed_of(run), u.iteration, u.environment_steps,
                                     f"{seconds:.1f}", f"{u.success_rate:.2f}", f"{u.entropy:.4f}",
                                     f"{u.approximate_kl:.5f}", f"{u.mean_proximity:.4f}",
                                     f"{u.mean_uncertainty:.4f}"])
                by_steps.plot(steps / 1e6, success, color=color, alpha=0.35, linewidth=0.8)
                by_time.plot(wall / 60, success, color=color, alpha=0.6, linewidth=0.8)
                curves.append((steps, success))
            common = np.arange(0, min(steps[-1] for steps, _ in curves), 10_000)
            mean = np.mean([np.interp(common, steps, success) for steps, success in curves], axis=0)
            by_steps.plot(common / 1e6, mean, color=color, linewidth=2,
                          label=f"{label} ({len(curves)} seed{'s' if len(curves) > 1 else ''})")
    by_steps.set_xlabel("environment steps, millions")
    by_time.set_xlabel("wall time, minutes")
    by_steps.set_ylabel("success, last 100 training episodes")
    by_steps.legend(loc="lower right")
    for axes in (by_steps, by_time):
        axes.set_ylim(0, 1.02)
        axes.grid(alpha=0.3)
    figure.suptitle(title)
    figure.tight_layout()
    figure.savefig(f"{out}.svg")


main()
