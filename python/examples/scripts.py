"""Scripted experts for environments of others: MountainCar, LunarLander, PointMaze and MiniGrid-FourRooms.

Each is made for one episode of an environment, after its reset, and gives what makes actions of
observations: `--set demonstrations.expert=scripts:lander`.
"""

from collections import deque

import numpy as np

# Of PointMaze's ball: force for every meter of distance, and for every meter per second.
PULL = 10.0
DAMPING = 1.0

# Of MiniGrid's agent: turn left, turn right, go forward; and where each direction leads to.
LEFT, RIGHT, FORWARD = 0, 1, 2
DIRECTIONS = [(1, 0), (0, 1), (-1, 0), (0, -1)]


def mountain_car(_):
    """MountainCarContinuous-v0: pushes the way it rolls."""
    return lambda seen: np.where(seen[1:] < 0.0, -1.0, 1.0)


def lander(environment):
    """LunarLander-v3: the script that comes with Gymnasium."""
    from gymnasium.envs.box2d.lunar_lander import heuristic

    return lambda seen: heuristic(environment.unwrapped, seen)


def point_maze(environment):
    """PointMaze: from cell to cell toward the goal, along a shortest way."""
    maze = environment.unwrapped.maze

    def act(seen):
        here, goal = seen["achieved_goal"], seen["desired_goal"]
        cell = tuple(maze.cell_xy_to_rowcol(here))
        way = distances(free_cells(maze), tuple(maze.cell_xy_to_rowcol(goal)))
        target = goal
        if way[cell] > 1:
            target = maze.cell_rowcol_to_xy(
                np.array(min(neighbors(cell), key=lambda cell: way.get(cell, np.inf)))
            )
        return np.clip(PULL * (target - here) - DAMPING * seen["observation"][2:], -1.0, 1.0)

    return act


def free_cells(maze):
    """The cells (row, column) of a maze that are no walls."""
    rows = enumerate(maze.maze_map)
    return {(row, column) for row, cells in rows for column, cell in enumerate(cells) if cell != 1}


def neighbors(cell):
    return [(cell[0] + down, cell[1] + right) for right, down in DIRECTIONS]


def distances(free, goal):
    """Steps from every free cell to the goal."""
    found, queue = {goal: 0}, deque([goal])
    while queue:
        cell = queue.popleft()
        for other in neighbors(cell):
            if other in free and other not in found:
                found[other] = found[cell] + 1
                queue.append(other)
    return found


def four_rooms(environment):
    """MiniGrid-FourRooms-v0: the fewest turns and steps to the goal, which the script sees wherever it is."""
    grid = environment.unwrapped

    def act(_):
        return first_action(grid, tuple(map(int, grid.agent_pos)), int(grid.agent_dir))

    return act


def first_action(grid, place, direction):
    """The first action of a shortest way from a place and a direction, by breadth-first search."""
    queue, known = deque([(place, direction, None)]), {(place, direction)}
    while queue:
        place, direction, first = queue.popleft()
        found = grid.grid.get(*place)
        if found is not None and found.type == "goal":
            return first
        ahead = (place[0] + DIRECTIONS[direction][0], place[1] + DIRECTIONS[direction][1])
        for action, state in (
            (FORWARD, (ahead, direction)),
            (LEFT, (place, (direction - 1) % 4)),
            (RIGHT, (place, (direction + 1) % 4)),
        ):
            cell = grid.grid.get(*state[0])
            if state not in known and (cell is None or cell.can_overlap()):
                known.add(state)
                queue.append((*state, action if first is None else first))
    raise ValueError("expected a way to the goal, found none")
