"""Steps Gymnasium environments in plain Python, for `transport.rs`: a line on standard input starts a round.

Usage: alone.py ID COPIES STEPS. Prints the seconds of each round.
"""

import sys
import time

import gymnasium

name, copies, steps = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
environments = [gymnasium.make(name) for _ in range(copies)]
for seed, environment in enumerate(environments):
    environment.action_space.seed(seed)
    environment.reset(seed=seed)

for _ in sys.stdin:
    actions = [[environment.action_space.sample() for _ in range(steps)] for environment in environments]
    begun = time.perf_counter()
    for step in range(steps):
        for environment, own in zip(environments, actions):
            _, _, terminated, truncated, _ = environment.step(own[step])
            if terminated or truncated:
                environment.reset()
    print(time.perf_counter() - begun, flush=True)
