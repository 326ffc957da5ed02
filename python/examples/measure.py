"""Measures the examples and prints the tables of README.md: experts, random actions, speed.

Usage: measure.py [--episodes 200]
"""

import argparse
import time

import ant
import fetch
import numpy as np

EXPERTS = {
    "Pick": (fetch.pick, fetch.pick_expert),
    "Push": (fetch.push, fetch.push_expert),
}
SETTINGS = [{}, {"coverage": 0.5}, {"noise": 2.0}, {"ranges": "one-sided"}]
RANDOM = {"Pick": fetch.pick, "Push": fetch.push, "Ant Reach": ant.reach}


def play(environment, seed, choose):
    """The observations of an episode in rows, and whether it succeeded."""
    seen, _ = environment.reset(seed=seed)
    act, observations, ended = choose(environment), [seen], False
    while not ended:
        seen, _, terminated, truncated, info = environment.step(act(seen))
        observations.append(seen)
        ended = terminated or truncated
    return np.array(observations), info["is_success"]


def play_all(environment, episodes, choose):
    """Episodes by seed, how many succeeded, and steps per second of processor time."""
    begun_s = time.process_time()
    played = [play(environment, seed, choose) for seed in range(episodes)]
    seconds = time.process_time() - begun_s
    steps = sum(len(observations) - 1 for observations, _ in played)
    return [o for o, _ in played], sum(success for _, success in played), steps / seconds


def expert_row(name, setting, episodes):
    make, expert = EXPERTS[name]
    played, successes, rate = play_all(make(**setting), episodes, expert)
    steps = [len(observations) - 1 for observations in played]
    way_mm = [1000 * np.linalg.norm((o[0, fetch.CUBE] - o[0, fetch.GOAL])[:2]) for o in played]
    words = ", ".join(f"{key} {value}" for key, value in setting.items()) or "the defaults"
    shares = " ".join(f"{share:.0f}" for share in np.percentile(steps, [5, 25, 50, 75, 95]))
    return row(
        f"{name}, {words}",
        f"{successes} of {episodes}",
        spread(steps),
        f"{min(steps)} to {max(steps)}",
        shares,
        spread(way_mm),
        f"{rate:,.0f}",
    )


def random_choice(draws):
    """Chooses uniform actions."""
    return lambda environment: lambda _: draws.uniform(-1, 1, environment.action_space.shape)


def random_rows(name, episodes):
    draws = np.random.default_rng(1)
    played, _, rate = play_all(RANDOM[name](), episodes, random_choice(draws))
    measures = ant_measures(played) if name == "Ant Reach" else fetch_measures(played)
    for measure, value in measures.items():
        yield row(f"{name}: {measure}", value)
    yield row(f"{name}: steps per second", f"{rate:,.0f}")


def fetch_measures(played):
    moved_m = np.array([np.linalg.norm((o[-1] - o[0])[fetch.CUBE]) for o in played])
    ways_m = [np.linalg.norm(np.diff(o[:, fetch.GRIP], axis=0), axis=1).mean() for o in played]
    return {
        "they move the cube by 1 cm": f"{np.sum(moved_m > 0.01)} of {len(played)}",
        "how far they move it, mm": spread(1000 * moved_m),
        "the gripper's way in a step, mm": spread(1000 * np.array(ways_m)),
    }


def ant_measures(played):
    torso_xy = [o[:, 13:15] - o[:, ant.TO_GOAL] for o in played]
    speeds = [np.linalg.norm(o[:, ant.VELOCITY][:, :3], axis=1).mean() for o in played]
    rates = [np.abs(o[:, ant.JOINT_RATES]).mean() for o in played]
    return {
        "travel of the torso in 5 s, m": spread([np.linalg.norm(p[-1] - p[0]) for p in torso_xy]),
        "mean height, m": spread([o[:, ant.HEIGHT].mean() for o in played]),
        "mean speed, m/s": spread(speeds),
        "mean rate of a joint, rad/s": spread(rates),
    }


def spread(numbers):
    """Mean and standard deviation."""
    return f"{np.mean(numbers):.2f} ({np.std(numbers, ddof=1):.2f})"


def row(*columns):
    return "| " + " | ".join(columns) + " |"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--episodes", type=int, default=200)
    episodes = parser.parse_args().episodes
    for name in EXPERTS:
        for setting in SETTINGS:
            print(expert_row(name, setting, episodes), flush=True)
    for name in RANDOM:
        for line in random_rows(name, episodes):
            print(line, flush=True)


if __name__ == "__main__":
    main()
