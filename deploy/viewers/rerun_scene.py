"""Shows recorded episodes in Rerun: their solids in three dimensions, and curves beside them.

    pip install rerun-sdk mcap mcap-protobuf-support
    python deploy/viewers/rerun_scene.py FILE.mcap                    # opens the viewer
    python deploy/viewers/rerun_scene.py FILE.mcap --save FILE.rrd    # writes what it opens
    python deploy/viewers/rerun_scene.py FILE.mcap --blueprint FILE.rbl    # writes the layout of its views

FILE was written by `goalward log scene` or `goalward evaluate`. It holds Foxglove's SceneUpdate messages,
which Rerun does not draw by itself. Each episode begins with its trajectory; its scenes follow.
"""

import argparse
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

APPLICATION = "goalward"

# Initial position of the eye and the point that it looks at, meters, by prefix of the task's name.
EYES = {
    "fetch": ([0.4, 0.25, 1.0], [1.3, 0.75, 0.4]),
    "ant": ([0.0, -6.0, 6.5], [0.0, 2.0, 0.0]),
}

# Curves: the name of the view, and the color of its line.
CURVES = {
    "distance": ("Distance to the goal, meters", [245, 119, 77]),
    "reward": ("Reward from the environment", [78, 152, 226]),
    "reached": ("Goal reached", [92, 214, 169]),
}


def vector(message: Any) -> list[float]:
    """Returns the three numbers of a vector."""
    return [message.x, message.y, message.z]


def quaternion(message: Any) -> list[float]:
    """Returns an orientation, the real part last."""
    return [message.x, message.y, message.z, message.w]


def color(message: Any) -> list[float]:
    """Returns a color with its opacity."""
    return [message.r, message.g, message.b, message.a]


def placed(parts: Iterable[Any]) -> dict[str, list[Any]]:
    """Returns the poses of parts and their colors."""
    parts = list(parts)
    return {
        "centers": [vector(part.pose.position) for part in parts],
        "quaternions": [quaternion(part.pose.orientation) for part in parts],
        "colors": [color(part.color) for part in parts],
    }


def log_entity(entity: Any) -> None:
    """Logs a solid, which consists of boxes, balls and cylinders."""
    path = f"scene/{entity.id.replace(' ', '_')}"
    fill = "solid"
    if entity.cubes:
        sizes = [vector(cube.size) for cube in entity.cubes]
        rr.log(f"{path}/boxes", rr.Boxes3D(sizes=sizes, fill_mode=fill, **placed(entity.cubes)))
    if entity.spheres:
        half = [[0.5 * side for side in vector(sphere.size)] for sphere in entity.spheres]
        rr.log(f"{path}/balls", rr.Ellipsoids3D(half_sizes=half, fill_mode=fill, **placed(entity.spheres)))
    if entity.cylinders:
        lengths = [cylinder.size.z for cylinder in entity.cylinders]
        radii = [0.5 * cylinder.size.x for cylinder in entity.cylinders]
        places = placed(entity.cylinders)
        rr.log(f"{path}/cylinders", rr.Cylinders3D(lengths=lengths, radii=radii, fill_mode=fill, **places))


def log_distance(entities: Iterable[Any]) -> None:
    """Logs the distance to the goal that the task judges by: the cube's, or the torso's along the floor."""
    solids = {entity.id: (*entity.cubes, *entity.spheres) for entity in entities}
    for name, axes in {"cube": 3, "torso": 2}.items():
        if solids.get(name) and solids.get("goal"):
            center, goal = (vector(solids[solid][0].pose.position) for solid in (name, "goal"))
            rr.log("episode/distance", rr.Scalars(np.linalg.norm(np.subtract(center, goal)[:axes])))


def log_step(trajectory: Any, step: int) -> None:
    """Logs the environment's reward for a step, and whether the goal had been reached."""
    if 0 < step <= len(trajectory.environment_rewards):
        rr.log("episode/reward", rr.Scalars(trajectory.environment_rewards[step - 1]))
    reached = trajectory.success and step >= trajectory.steps_to_goal
    rr.log("episode/reached", rr.Scalars(float(reached)))


def log_file(file: Path) -> int:
    """Logs all episodes of a file, one after another; returns the number of frames."""
    trajectory, step, frames = None, 0, 0
    with file.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, channel, message, content in reader.iter_decoded_messages(log_time_order=False):
            if channel.topic.endswith("trajectory"):
                trajectory, step = content, 0
            elif channel.topic.endswith("scene"):
                rr.set_time("time", duration=np.timedelta64(message.log_time, "ns"))
                rr.set_time("step", sequence=step)
                for entity in content.entities:
                    log_entity(entity)
                log_distance(content.entities)
                log_step(trajectory, step)
                step, frames = step + 1, frames + 1
    return frames


def task_of(file: Path) -> str:
    """Returns the task of a file's first episode; an empty text if there is none."""
    with file.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, channel, _, content in reader.iter_decoded_messages(log_time_order=False):
            if channel.topic.endswith("trajectory"):
                return str(content.task)
    return ""


def blueprint(task: str) -> rrb.Blueprint:
    """Returns the views: the scene as it is best seen, curves below it, the viewer's own panels collapsed."""
    eye = next((eye for name, eye in EYES.items() if task.startswith(name)), None)
    controls = rrb.EyeControls3D(position=eye[0], look_target=eye[1]) if eye else None
    scene = rrb.Spatial3DView(origin="scene", name="Scene", eye_controls=controls)
    curves = [rrb.TimeSeriesView(origin=f"episode/{curve}", name=name) for curve, (name, _) in CURVES.items()]
    return rrb.Blueprint(
        rrb.Vertical(scene, rrb.Horizontal(*curves), row_shares=[3, 1]), collapse_panels=True
    )


def main() -> None:
    """Runs the command."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file", type=Path)
    outputs = parser.add_mutually_exclusive_group()
    outputs.add_argument("--save", type=Path, metavar="FILE.rrd", help="write it, open no viewer")
    outputs.add_argument(
        "--blueprint", type=Path, metavar="FILE.rbl", help="write the views only, open no viewer"
    )
    options = parser.parse_args()
    views = blueprint(task_of(options.file))
    if options.blueprint:
        views.save(APPLICATION, options.blueprint)
        return
    rr.init(APPLICATION, spawn=options.save is None)
    if options.save:
        rr.save(options.save)
    rr.send_blueprint(views)
    for curve, (_, color_of_line) in CURVES.items():
        rr.log(f"episode/{curve}", rr.SeriesLines(colors=[color_of_line], names=[curve]), static=True)
    frames = log_file(options.file)
    if frames == 0:
        parser.exit(1, f"{options.file}: expected scenes, found none; a grid has no solids\n")
    print(f"{options.file}: {frames} frames")


if __name__ == "__main__":
    main()
