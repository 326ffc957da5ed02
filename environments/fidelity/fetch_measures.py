"""Measurements of the Fetch tasks: how gripper, fingers and cube respond, and the experts."""

import fetch
import numpy as np
import table
from play import in_turn, play, play_both
from rapier import Goalward

LIFT_M = 0.15


def gripper():
    """Actions along an axis from rest, and the coasting after them."""
    mujoco, goalward = fetch.Fetch("fetch-pick"), Goalward("fetch-pick", noise=0)
    rows = []
    for name, action, after_steps in [
        ("x, action 1", [1, 0, 0, 0], [1, 2, 3, 4, 5]),
        ("x, action 0.3", [0.3, 0, 0, 0], [1, 5]),
        ("-y, action 1", [0, -1, 0, 0], [1, 5]),
        ("z, action 1", [0, 0, 1, 0], [1, 5]),
        ("-z, action 0.1", [0, 0, -0.1, 0], [1, 5]),
    ]:
        actions = [action] * 5 + [[0, 0, 0, 0]]
        both = play_both(mujoco, goalward, 0, in_turn(actions), len(actions))
        axis, sign = int(np.argmax(np.abs(action))), np.sign(np.sum(action))
        moved_mm = [1000 * sign * (o[:, axis] - o[0, axis]) for o in both]
        for steps in after_steps:
            measure = f"gripper along {name}, after step {steps}, mm"
            rows.append(table.numbers(measure, moved_mm[0][steps], moved_mm[1][steps]))
        coast = [moved[6] - moved[5] for moved in moved_mm]
        rows.append(table.numbers(f"gripper along {name}, coasting one step, mm", *coast))
    return rows


def fingers():
    """Opening and closing in the air, with the experts' actions and with the largest ones."""
    mujoco, goalward = fetch.Fetch("fetch-pick"), Goalward("fetch-pick", noise=0)
    rows = []
    for size in [0.05, 1.0]:
        actions = [[0, 0, 0, size]] * 3 + [[0, 0, 0, -size]] * 3
        both = play_both(mujoco, goalward, 0, in_turn(actions), len(actions))
        opened_mm = [1000 * np.mean(o[:, fetch.FINGERS], axis=1) for o in both]
        for steps in range(1, 7):
            verb = "opening" if steps <= 3 else "closing"
            measure = f"fingers {verb}, action {size}, step {steps}: each open by, mm"
            rows.append(table.numbers(measure, opened_mm[0][steps], opened_mm[1][steps]))
    return rows


def push():
    """The closed fingers push against the middle of a face of the cube, at full action."""
    mujoco, goalward = fetch.Fetch("fetch-push"), Goalward("fetch-push", noise=0)
    actions = [[0, 1, 0]] * 6 + [[0, 0, 0]] * 6
    both = play_both(mujoco, goalward, 0, in_turn(actions), len(actions))
    moved_mm = [1000 * (o[:, fetch.CUBE] - o[0, fetch.CUBE]) for o in both]
    rows = [
        table.numbers(f"cube along the push after step {steps}, mm", *(moved[steps, 1] for moved in moved_mm))
        for steps in [2, 3, 4, 5, 6]
    ]
    coast = [moved[12, 1] - moved[6, 1] for moved in moved_mm]
    rows.append(table.numbers("cube sliding on when the gripper stops, mm", *coast))
    rows.append(table.numbers("cube to the side, mm", *(moved[12, 0] for moved in moved_mm)))
    return rows


def press():
    """The closed fingers press down on the cube, in its middle and 15 mm off it along both axes."""
    mujoco, goalward = fetch.Fetch("fetch-push"), Goalward("fetch-push", noise=0)
    rows = []
    for place, off_m in [("in the middle", 0.0), ("near a corner", 0.015)]:
        first = goalward.begin(0)
        over = first[fetch.CUBE] + [off_m, off_m, 0.075]
        both = [pressed(mujoco, mujoco.begin(first), over), pressed(goalward, first, over)]
        lowest_mm = [1000 * np.min(o[:, fetch.CUBE][:, 2] - o[0, fetch.CUBE][2]) for o in both]
        rows.append(table.numbers(f"cube pressed {place}, lowest, mm", *lowest_mm))
        tilts_rad = [np.max(np.abs(o[:, fetch.CUBE_TILT])) for o in both]
        rows.append(table.numbers(f"cube pressed {place}, largest tilt, rad", *tilts_rad, digits=2))
    return rows


def pressed(world, first, over):
    """Moves up, then above the cube, then down for four steps."""
    targets = [first[fetch.GRIPPER] + [0, 0, 0.1]] * 15 + [over] * 25
    left = iter(targets)

    def choose(observation):
        target = next(left, None)
        return [0, 0, -0.5] if target is None else 6 * (target - observation[fetch.GRIPPER])

    return play(world, first, choose, len(targets) + 4)


def hold(episodes):
    """The authors' expert grasps, lifts straight up, and holds until step fifty."""
    mujoco, goalward = fetch.Fetch("fetch-pick"), Goalward("fetch-pick")
    held, errors_mm, slips_mm, open_mm = [], [], [], []
    for episode in range(episodes):
        first = goalward.begin(episode)
        ends = [lift(mujoco, mujoco.begin(first)), lift(goalward, first)]
        held.append([fetch.succeeded(o[-1]) for o in ends])
        errors_mm.append([1000 * fetch.distance(o[-1]) for o in ends])
        slips_mm.append([1000 * slip(o) for o in ends])
        open_mm.append([1000 * np.mean(o[-1, fetch.FINGERS]) for o in ends])
    count = f"{episodes} episodes"
    return [
        table.shares(f"grasp, lift {LIFT_M} m and hold to step 50, {count}", *np.transpose(held)),
        table.samples("cube from its target at step 50, mm", *np.transpose(errors_mm)),
        table.samples("cube slipping in the fingers, step 30 to 50, mm", *np.transpose(slips_mm)),
        table.samples("each finger open around the cube at step 50, mm", *np.transpose(open_mm)),
    ]


def lift(world, first):
    """Runs the expert with the goal above the cube; no task has it there, so no episode ends early."""
    expert = fetch.PickExpert()
    goal = first[fetch.CUBE] + [0, 0, LIFT_M]

    def moved(observation):
        return np.concatenate([observation[: fetch.GOAL.start], goal])

    observations = play(world, first, lambda o: expert.action(moved(o)), 50)
    return np.array([moved(observation) for observation in observations])


def slip(observations):
    between = observations[:, fetch.CUBE_FROM_GRIPPER]
    return np.linalg.norm(between[50] - between[30])


def experts(task, episodes):
    """The authors' expert on both sides, and Goalward's own on its side, until success or the horizon."""
    mujoco, goalward = fetch.Fetch(task), Goalward(task)
    horizon = fetch.HORIZON_STEPS[task]
    plays = []
    for episode in range(episodes):
        chooser = lambda: fetch.EXPERTS[task]().action
        both = play_both(mujoco, goalward, episode, chooser, horizon, fetch.succeeded)
        own = goalward.begin(episode)
        own = play(goalward, own, lambda _: goalward.expert_action(), horizon, fetch.succeeded)
        plays.append([*both, own])
    good = np.array([[fetch.succeeded(o[-1]) for o in played] for played in plays]).T
    steps = np.array([[len(o) - 1 for o in played] for played in plays]).T
    count, name = f"{episodes} episodes", task.removeprefix("fetch-").capitalize()
    return [
        table.shares(f"{name}: the authors' expert succeeds, {count}", good[0], good[1]),
        table.samples(f"{name}: steps of its episodes", steps[0], steps[1]),
        table.shares(f"{name}: Goalward's own expert succeeds, {count}", good[0], good[2]),
        table.samples(f"{name}: steps of its episodes", steps[0], steps[2]),
    ]


def random_actions(task, episodes):
    """How often random exploration moves the cube."""
    mujoco, goalward = fetch.Fetch(task), Goalward(task)
    draws = np.random.default_rng(1)
    width, horizon = {"fetch-pick": 4, "fetch-push": 3}[task], fetch.HORIZON_STEPS[task]
    moved_m, step_mm, tipped = [], [], []
    for episode in range(episodes):
        actions = in_turn(draws.uniform(-1, 1, (horizon, width)))
        both = play_both(mujoco, goalward, episode, actions, horizon, fetch.succeeded)
        moved_m.append([np.linalg.norm((o[-1] - o[0])[fetch.CUBE]) for o in both])
        steps = [np.diff(o[:, fetch.GRIPPER], axis=0) for o in both]
        step_mm.append([1000 * np.mean(np.linalg.norm(step, axis=1)) for step in steps])
        tipped.append([np.max(np.abs(o[:, fetch.CUBE_TILT])) > np.pi / 4 for o in both])
    moved_m = np.transpose(moved_m)
    name, count = task.removeprefix("fetch-").capitalize(), f"{episodes} episodes"
    return [
        table.shares(f"{name}: random actions move the cube by 1 cm, {count}", *(moved_m > 0.01)),
        table.shares(f"{name}: they tip it by 45 degrees", *np.transpose(tipped)),
        table.samples(f"{name}: how far they move it, mm", *(1000 * moved_m), digits=1),
        table.samples(f"{name}: the gripper's way in a step, mm", *np.transpose(step_mm), digits=1),
    ]
