"""Measures what an open page costs the training run that it shows.

One run trains. In every other window of a few seconds, three clients read its page as browsers do; in
between, page and clients are paused. The duration of an iteration is compared between consecutive windows, so
that other load on the machine affects both.

    target/python/bin/python docs/page/cost.py target/release/goalward [MINUTES]
"""

import json
import random
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import time
import urllib.parse
import urllib.request
from itertools import pairwise
from pathlib import Path

from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader

WINDOW_S = 6.0
CLIENTS = 3
# Iterations that begin this soon after the start of a window are left out.
EDGE_S = 0.3


class Client(threading.Thread):
    """Reads a page as a browser does: new curves at every event, the processes every two seconds."""

    def __init__(self, url, run, open_):
        super().__init__(daemon=True)
        self.url, self.run_, self.open_ = url, urllib.parse.quote(run), open_
        self.updates = 0

    def address(self, path):
        """Returns the address of something of the page's API, with the token that the page printed."""
        mark = "&" if "?" in path else "?"
        return f"{self.url.scheme}://{self.url.netloc}/api/{path}{mark}{self.url.query}"

    def get(self, path):
        """Returns the JSON response of the page."""
        with urllib.request.urlopen(self.address(path), timeout=60) as answer:
            return json.load(answer)

    def run(self):
        """Reads while the page is open, and waits otherwise."""
        self.get("runs")
        self.get(f"runs/{self.run_}")
        while True:
            self.open_.wait()
            with urllib.request.urlopen(self.address("events"), timeout=60) as events:
                looked = 0.0
                for line in events:
                    if not self.open_.is_set():
                        break
                    if line.startswith(b"data:"):
                        self.updates = self.get(f"runs/{self.run_}/updates?from={self.updates}")["next"]
                    if time.time() - looked > 2:
                        looked = time.time()
                        self.get(f"runs/{self.run_}/processes")


def iterations(run):
    """Returns end and duration of every iteration in seconds; log times are wall-clock times."""
    ends = []
    for file in sorted((run / "log").glob("updates-*")):
        with file.open("rb") as stream:
            topics = {}
            for record in StreamReader(stream).records:
                if isinstance(record, Channel):
                    topics[record.id] = record.topic
                elif isinstance(record, Message) and "policy" in topics[record.channel_id]:
                    ends.append(record.log_time / 1e9)
    return [(end, end - start) for start, end in pairwise(ends)]


def main(goalward, minutes):
    """Trains and reads for some minutes, then prints the result."""
    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder) / "runs" / "measured"
        run.parent.mkdir()
        training = subprocess.Popen(
            [
                goalward,
                "-q",
                "train",
                "navigation",
                "--run",
                run,
                "--no-page",
                "--steps",
                "100000000",
            ],
            stdout=subprocess.DEVNULL,
        )
        page = subprocess.Popen(
            [goalward, "page", run.parent, "--port", "0"],
            stdout=subprocess.PIPE,
            text=True,
        )
        url = urllib.parse.urlsplit(page.stdout.readline().split()[0])
        while not any((run / "checkpoints").glob("0*")):
            if training.poll() is not None:
                page.terminate()
                sys.exit("expected a run that trains, found that it has ended")
            time.sleep(0.5)
        open_ = threading.Event()
        for _ in range(CLIENTS):
            Client(url, run.name, open_).start()
        windows = []
        until = time.time() + minutes * 60
        while time.time() < until:
            is_open = len(windows) % 2 == 0
            page.send_signal(signal.SIGCONT if is_open else signal.SIGSTOP)
            (open_.set if is_open else open_.clear)()
            start = time.time()
            time.sleep(WINDOW_S)
            windows.append((is_open, start + EDGE_S, time.time()))
        open_.clear()
        page.send_signal(signal.SIGCONT)
        training.send_signal(signal.SIGINT)
        training.wait()
        page.terminate()
        tell(windows, iterations(run))


def tell(windows, ended):
    """Prints the ratio of an iteration's duration with the page to that without, and its interval."""
    means = []
    for _, start, end in windows:
        inside = [seconds for at, seconds in ended if at - seconds >= start and at <= end]
        means.append(statistics.fmean(inside) if inside else None)
    pairs = [one / other for one, other in zip(means[::2], means[1::2], strict=False) if one and other]
    choices = random.Random(1).choices
    drawn = [statistics.fmean(choices(pairs, k=len(pairs))) for _ in range(10_000)]
    low, high = (statistics.quantiles(drawn, n=40)[at] for at in (0, -1))
    print(
        f"{len(pairs)} pairs of windows: an iteration takes {statistics.fmean(pairs):.4f} times as long "
        f"with the page and {CLIENTS} clients (95 %: {low:.4f} to {high:.4f})"
    )


if __name__ == "__main__":
    main(sys.argv[1], float(sys.argv[2]) if len(sys.argv) > 2 else 5.0)
