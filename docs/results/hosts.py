"""Measures steps per second of runs whose actors are on other machines.

Usage: hosts.py scaling    (up to 64 actors of an environment that waits, on up to eight machines)
       hosts.py distance [ROUNDS]    (one actor here, or on a machine 0, 1 and 20 milliseconds away)

    pip install -r docs/results/requirements.txt ./python

It also needs `goalward` with its gateway in PATH, and the program of deploy/examples/reacher. Another machine
is a `goalward join` with its own folder and bus. A distance is simulated by a relay between it and the run,
which delays every byte by half of the distance. Steps per second are measured from the first policy update to
the last. The results go to hosts_scaling.csv and hosts_scaling.svg, or to hosts_distance.csv, beside this
file; a table is printed.
"""

import asyncio
import csv
import os
import pathlib
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time

import matplotlib

matplotlib.use("svg")
import matplotlib.pyplot as plt
from scaling import steps_per_second

from goalward.log import Log

TICKS = os.sysconf("SC_CLK_TCK")
HERE = pathlib.Path(__file__).resolve().parent
REACHER = HERE.parents[1] / "deploy/examples/reacher/reacher.toml"


def settings(pairs):
    return [word for pair in pairs for word in ("--set", pair)]


# Lanes of each actor, and least steps of a lane: one episode. With SCALING, the learner is hardly the limit.
LANES, LANE_STEPS = 16, 60
SCALING = [
    "method=environment-reward",
    f"rollout.lane_steps={LANE_STEPS}",
    "policy.hidden=[64, 64]",
    "policy.activation=relu",
    "ppo.epochs=2",
    "ppo.minibatches=16",
]
HOSTS_AND_ACTORS = [(1, 1), (1, 8), (2, 8), (4, 8), (8, 8)]
# Milliseconds a step, and iterations after the first; an iteration takes about one or ten seconds.
WAITS = {1: 15, 10: 3}

GATEWAYS = ["own_gateway", "other_gateways"]  # per cent of a core at 10,000 steps per second
DISTANCES = [None, 0, 1, 20]
# Both have iterations of about two seconds.
DISTANT = {
    "ant-reach": ["ant-reach", "--set", "steps=48000"],
    "a millisecond a step": [
        REACHER,
        *settings(SCALING),
        *settings(["rollout.lanes=32", "environment.step_ms=1", "steps=19200"]),
    ],
}


class Relay:
    """A relay between a machine and the run, which forwards data after a delay in milliseconds."""

    def __init__(self, port, milliseconds):
        self.port, self.delay, self.loop = port, milliseconds / 1000, asyncio.new_event_loop()
        self.server = self.loop.run_until_complete(asyncio.start_server(self.connect, "127.0.0.1", 0))
        self.address = f"127.0.0.1:{self.server.sockets[0].getsockname()[1]}"
        threading.Thread(target=self.loop.run_forever, daemon=True).start()

    async def connect(self, reader, writer):
        try:
            there = await asyncio.open_connection("127.0.0.1", self.port)
        except OSError:
            writer.close()
            return
        await asyncio.gather(self.carry(reader, there[1]), self.carry(there[0], writer))

    async def carry(self, reader, writer):
        writer.get_extra_info("socket").setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        while data := await reader.read(1 << 16):
            self.loop.call_later(self.delay, writer.write, data)
        self.loop.call_later(self.delay, writer.close)

    def end(self):
        self.loop.call_soon_threadsafe(self.loop.stop)


def free_port():
    with socket.socket() as bound:
        bound.bind(("127.0.0.1", 0))
        return bound.getsockname()[1]


def gateway_seconds():
    """Returns for each live gateway process whether it is the run's own, and its processor seconds."""
    found = {}
    for process in pathlib.Path("/proc").glob("[0-9]*"):
        try:
            command = (process / "cmdline").read_bytes().split(b"\0")
            if command[0].endswith(b"goalward-gateway"):
                user, system = (process / "stat").read_text().rsplit(")")[1].split()[11:13]
                found[process.name] = command[1] == b"serve", (int(user) + int(system)) / TICKS
        except (OSError, IndexError):
            pass  # the process has just ended
    return found


def train(arguments, hosts, actors, milliseconds=None):
    """Trains a run with `actors` actors on each of `hosts` machines, or here if `hosts` is 0.

    Returns its steps per second, and the per cent of a core that its own gateway and the others take at
    10,000 steps per second.
    """
    with tempfile.TemporaryDirectory() as folder:
        run, port = pathlib.Path(folder) / "run", free_port()
        command = ["goalward", "train", *arguments, "--run", run, "--no-page"]
        command += ["--actors", str(0 if hosts else actors)]
        command += ["--listen", f"127.0.0.1:{port}"] if hosts else []
        relay = None if milliseconds is None else Relay(port, milliseconds / 2)
        address = relay.address if relay else f"127.0.0.1:{port}"
        with open(run.with_suffix(".txt"), "w") as said:
            training = subprocess.Popen(command, stdout=said, stderr=said)
            joined = [join(training, run, address, actors, number, said) for number in range(hosts)]
            seconds = {}
            while training.poll() is None:
                seconds |= gateway_seconds()
                time.sleep(0.2)
            ended = training.wait() + sum(host.wait() for host in joined)
        if relay:
            relay.end()
        if ended:
            sys.exit(run.with_suffix(".txt").read_text())
        updates = Log(run).updates()
        rate, steps = steps_per_second(updates), updates["environment_steps"][-1]
        taken = [sum(s for own, s in seconds.values() if own == side) for side in (True, False)]
        return rate, *(round(100 * seconds / (steps / 1e4), 2) for seconds in taken)


def join(training, run, address, actors, number, said):
    while not (run / "join.toml").exists():
        if training.poll() is not None:
            sys.exit(run.with_suffix(".txt").read_text())
        time.sleep(0.05)
    command = ["goalward", "join", address, "--key", run / "join.toml", "--actors", str(actors)]
    return subprocess.Popen([*command, "--name", f"machine-{number}"], stdout=said, stderr=said)


def scaling():
    rows = []
    for wait, iterations in WAITS.items():
        for lag in 0, 1:
            for hosts, each in HOSTS_AND_ACTORS:
                lanes = LANES * hosts * each
                own = [
                    f"environment.step_ms={wait}",
                    f"rollout.lag={lag}",
                    f"rollout.lanes={lanes}",
                    f"steps={lanes * LANE_STEPS * (1 + iterations)}",
                ]
                rate, hub, others = train([REACHER, *settings(SCALING + own)], hosts, each)
                rows.append([wait, lag, hosts, hosts * each, round(rate, 1), hub, others])
                print(*rows[-1], flush=True)
    keep("hosts_scaling.csv", ["step_ms", "lag", "machines", "actors", "steps_per_s", *GATEWAYS], rows)
    draw(rows)


def draw(rows):
    figure, axes = plt.subplots(figsize=(6, 3.6))
    for wait in WAITS:
        for lag, marker in (0, "o"), (1, "s"):
            rates = {row[3]: row[4] for row in rows if row[:2] == [wait, lag]}
            axes.plot([*rates], [*rates.values()], marker=marker, label=f"{wait} ms a step, lag {lag}")
            for actors, rate in rates.items():
                part = 100 * rate / (actors * rates[1])
                print(f"| {wait} ms | {lag} | {actors} | {rate:,.0f} | {part:.0f} % |")
        one = next(row[4] for row in rows if (row[0], row[3]) == (wait, 1))
        axes.plot([1, 64], [one, 64 * one], color="0.7", linewidth=1, zorder=0)
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="actors, eight on a machine at most",
        ylabel="environment steps per second",
    )
    axes.set_xticks([1, 8, 16, 32, 64], [1, 8, 16, 32, 64])
    axes.legend()
    figure.tight_layout()
    figure.savefig(HERE / "hosts_scaling.svg")


def distance(rounds):
    rows = []
    for number in range(rounds):
        for task, arguments in DISTANT.items():
            for milliseconds in DISTANCES:
                hosts = 0 if milliseconds is None else 1
                rate, hub, others = train(arguments, hosts, 1, milliseconds)
                place = "here" if milliseconds is None else milliseconds
                rows.append([task, place, number, round(rate, 1), hub, others])
                print(*rows[-1], flush=True)
    keep("hosts_distance.csv", ["task", "distance_ms", "round", "steps_per_s", *GATEWAYS], rows)
    for task in DISTANT:
        rates = {place: [row[3] for row in rows if row[:2] == [task, place]] for _, place, *_ in rows}
        for place, found in rates.items():
            parts = [100 * rate / here for rate, here in zip(found, rates["here"])]
            shown = ", ".join(f"{part:.0f}" for part in parts)
            print(f"| {task} | {place} | {statistics.mean(found):,.0f} | {shown} |")


def keep(name, head, rows):
    with open(HERE / name, "w", newline="") as file:
        csv.writer(file).writerows([head, *rows])


def main():
    match sys.argv[1:]:
        case ["scaling"]:
            scaling()
        case ["distance", *rounds]:
            distance(int(rounds[0]) if rounds else 3)
        case _:
            sys.exit(__doc__)


if __name__ == "__main__":
    main()
