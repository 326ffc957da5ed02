"""Tests of logs of runs: each record counts once, in order, as far as the files can be read."""

import warnings
from pathlib import Path

import numpy as np
import pytest
from logs import CONFIG, trajectory, write
from walks import REACH, ROOMS, rooms, walk

from goalward import Error, schema
from goalward.demonstrations import Episode
from goalward.demonstrations import write as write_demonstrations
from goalward.log import IncompleteLog, Log, to_pandas, to_polars

FIRST, SECOND = "log/trajectories-00000.mcap", "log/trajectories-00001.mcap"
UPDATES = "log/updates-00000.mcap"


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """Write two iterations of two lanes; the second iteration is recorded again in another file."""
    goal = {"ending": schema.GOAL_REACHED, "success": True, "steps_to_goal": 2}
    scored = schema.Score(lane=1, rewards=[0.5, 0.25], proximity=[0.1, 0.2, 0.3], uncertainty=[0, 0, 1])
    before = [
        ("/trajectory", trajectory(0, 0, 0, steps=3)),
        ("/proximity/score", scored),
        ("/trajectory", trajectory(0, 1, 0, steps=2, **goal)),
        ("/trajectory", trajectory(1, 0, 1, steps=5)),
    ]
    after = [
        ("/trajectory", trajectory(1, 0, 1, steps=4, policy_version=9)),
        ("/evaluation/trajectory", trajectory(1, 0, 7, steps=1, source=schema.EVALUATION)),
    ]
    write(tmp_path / FIRST, before)
    write(tmp_path / SECOND, after, since=10)
    consumed = [{"lane": 1}]
    updates = [
        ("/policy/update", schema.PolicyUpdate(iteration=0, policy_loss=0.5, consumed=consumed)),
        ("/policy/update", schema.PolicyUpdate(iteration=1, policy_loss=0.25, weights_sha256="ab")),
        ("/proximity/update", schema.RewardUpdate(iteration=0, model_version=1, seconds=2.5)),
        ("/proximity/update", schema.RewardUpdate(iteration=0, model_version=2, seconds=1.5)),
    ]
    write(tmp_path / UPDATES, updates, since=20)
    return tmp_path


def sit(run: Path, number: int, batches: list[int], updates: list[int]) -> None:
    """Record iterations as a run does between restarts; the first reward update is offline training."""
    recorded, learned = [], [("/proximity/update", schema.RewardUpdate())]
    for iteration in batches:
        recorded += [
            ("/trajectory", trajectory(iteration, 0, iteration, steps=2)),
            ("/evaluation/trajectory", trajectory(iteration, 0, 7, steps=1, source=schema.EVALUATION)),
            ("/proximity/score", schema.Score(iteration=iteration, rewards=[0.5])),
        ]
    for iteration in updates:
        learned += [
            ("/policy/update", schema.PolicyUpdate(iteration=iteration)),
            ("/proximity/update", schema.RewardUpdate(iteration=iteration, model_version=iteration + 1)),
        ]
    write(run / f"log/trajectories-0000{number}.mcap", recorded, since=100 * number)
    write(run / f"log/updates-0000{number}.mcap", learned, since=100 * number + 50)


def test_a_log_tells_task_and_configuration(run: Path) -> None:
    log = Log(run)
    assert log.task == REACH
    assert log.config == {"method": "goal-proximity", "seed": 3, "ppo": {"clip": 0.2}}
    assert log.metadata["seed"] == "3"


def test_trajectories_have_the_shapes_of_their_task(run: Path) -> None:
    first = next(Log(run).trajectories())
    np.testing.assert_array_equal(first.observations, walk(3, 0))
    np.testing.assert_array_equal(first.actions, [[0, 0.25], [0.5, 0.75], [1, 1.25]])
    np.testing.assert_array_equal(first.rewards, [0, 1, 2])
    np.testing.assert_array_equal(first.log_probs, [-0.5] * 3)
    assert (first.iteration, first.lane, first.episode, first.policy_version) == (0, 0, 0, 0)
    assert (first.steps, first.ending, first.success, first.steps_to_goal) == (3, "truncated", False, 0)


@pytest.mark.parametrize(
    ("setting", "acted"),
    [("", [[0, 0.25], [0.5, 0.75], [1, 1]]), ("action_scale = [0.5, 2]", [[0, 0.5], [0.25, 1], [0.5, 1]])],
)
def test_actions_are_scaled_before_they_are_clipped(
    tmp_path: Path, setting: str, acted: list[list[float]]
) -> None:
    messages = [("/trajectory", trajectory(0, 0, 0, steps=3))]
    write(tmp_path / FIRST, messages, config=f"{CONFIG}[environment]\n{setting}\n")
    log = Log(tmp_path)
    [found] = log.acted(log.trajectories())
    np.testing.assert_array_equal(found.actions, acted)
    np.testing.assert_array_equal(found.observations, walk(3, 0))


def test_a_scale_for_other_actions_is_refused(tmp_path: Path) -> None:
    messages = [("/trajectory", trajectory(0, 0, 0, steps=3))]
    write(tmp_path / FIRST, messages, config=f"{CONFIG}[environment]\naction_scale = [0.5]\n")
    log = Log(tmp_path)
    with pytest.raises(Error, match="action_scale: expected 2 factors, found 1"):
        next(log.acted(log.trajectories()))


def test_a_grid_has_the_shape_of_its_task(tmp_path: Path) -> None:
    cells = rooms(2, 0).tobytes()
    grid = {"values": [], "cells": cells, "continuous_actions": [], "discrete_actions": bytes([3, 1])}
    write(tmp_path / FIRST, [("/trajectory", trajectory(0, 0, 0, steps=2, **grid))], ROOMS)
    [found] = Log(tmp_path).trajectories()
    np.testing.assert_array_equal(found.observations, rooms(2, 0))
    assert found.actions.tolist() == [3, 1]
    assert Log(tmp_path).steps()["action"].tolist() == [3, 1]


def test_what_was_recorded_again_counts_once(run: Path) -> None:
    found = [(one.iteration, one.lane, one.episode, one.steps) for one in Log(run).trajectories()]
    assert found == [(0, 0, 0, 3), (0, 1, 0, 2), (1, 0, 1, 4)]
    assert Log(run).episodes()["policy_version"].tolist() == [0, 0, 9]


def test_what_going_back_undid_does_not_count_until_it_is_done_again(tmp_path: Path) -> None:
    sit(tmp_path, 0, batches=[0, 1, 2, 3], updates=[0, 1, 2, 3])
    sit(tmp_path, 1, batches=[1, 2], updates=[1])
    log = Log(tmp_path)
    assert log.episodes()["iteration"].tolist() == [0, 1, 2]
    assert [one.iteration for one in log.trajectories("evaluation")] == [0, 1, 2]
    assert log.scores()["iteration"].tolist() == [0, 0, 1, 1, 2, 2]
    assert log.updates()["iteration"].tolist() == [0, 1]
    assert log.reward_updates()["iteration"].tolist() == [0, 0, 1]


def test_the_training_ahead_of_the_first_iteration_is_there_when_all_was_undone(tmp_path: Path) -> None:
    sit(tmp_path, 0, batches=[0, 1], updates=[0, 1])
    sit(tmp_path, 1, batches=[0], updates=[0])
    assert Log(tmp_path).reward_updates()["model_version"].tolist() == [0, 1]
    assert Log(tmp_path).updates()["iteration"].tolist() == [0]


def test_files_that_are_sealed_while_they_are_read_are_followed(tmp_path: Path) -> None:
    for name, number in ((FIRST, 0), (SECOND, 1)):
        write(tmp_path / f"{name}.active", [("/trajectory", trajectory(number, 0, number, steps=3))])
    log = Log(tmp_path)
    reading = log.trajectories()
    found = [next(reading).iteration]
    for name in (FIRST, SECOND):
        (tmp_path / f"{name}.active").rename(tmp_path / name)
    found += [one.iteration for one in reading]
    assert found == [0, 1]
    assert log.endings[tmp_path / SECOND].complete


def test_evaluation_episodes_are_asked_for(run: Path) -> None:
    assert [one.episode for one in Log(run).trajectories("evaluation")] == [7]
    with pytest.raises(Error, match="source: expected training or evaluation, found tests"):
        Log(run).trajectories("tests")  # type: ignore[arg-type]


def test_episodes_have_a_row_each(run: Path) -> None:
    columns = Log(run).episodes()
    assert columns["steps"].tolist() == [3, 2, 4]
    assert columns["environment_return"].tolist() == [3, 1, 6]
    assert columns["ending"].tolist() == ["truncated", "goal_reached", "truncated"]
    assert columns["success"].tolist() == [False, True, False]
    assert columns["steps_to_goal"].tolist() == [0, 2, 0]


def test_steps_have_a_row_each(run: Path) -> None:
    columns = Log(run).steps()
    assert columns["lane"].tolist() == [0, 0, 0, 1, 1, 0, 0, 0, 0]
    assert columns["step"].tolist() == [1, 2, 3, 1, 2, 1, 2, 3, 4]
    assert columns["action[1]"][:3].tolist() == [0.25, 0.75, 1.25]
    assert columns["reward"].tolist() == [0, 1, 2, 0, 1, 0, 1, 2, 3]


def test_scores_have_a_row_for_each_observation(run: Path) -> None:
    columns = Log(run).scores()
    assert columns["step"].tolist() == [0, 1, 2]
    assert columns["lane"].tolist() == [1, 1, 1]
    np.testing.assert_array_equal(columns["reward"], np.array([np.nan, 0.5, 0.25], np.float32))
    np.testing.assert_array_equal(columns["proximity"], np.array([0.1, 0.2, 0.3], np.float32))


def test_a_model_of_steps_says_nothing_of_the_first_observation(tmp_path: Path) -> None:
    score = schema.Score(rewards=[0.5, 0.25], proximity=[0.75, 1], uncertainty=[0, 0])
    write(tmp_path / FIRST, [("/proximity/score", score)])
    np.testing.assert_array_equal(
        Log(tmp_path).scores()["proximity"], np.array([np.nan, 0.75, 1], np.float32)
    )


def test_updates_have_a_column_for_each_value(run: Path) -> None:
    columns = Log(run).updates()
    assert columns["policy_loss"].tolist() == [0.5, 0.25]
    assert columns["weights_sha256"].tolist() == ["", "ab"]
    assert "consumed" not in columns
    assert Log(run).reward_updates()["seconds"].tolist() == [2.5, 1.5]


def test_a_log_without_messages_has_columns_without_rows(tmp_path: Path) -> None:
    write(tmp_path / FIRST, [])
    log = Log(tmp_path)
    for columns in (log.episodes(), log.steps(), log.scores(), log.updates(), log.reward_updates()):
        assert columns
        assert {len(column) for column in columns.values()} == {0}


def test_tables_become_frames(run: Path) -> None:
    columns = Log(run).episodes()
    assert to_polars(columns)["steps"].to_list() == [3, 2, 4]
    assert to_pandas(columns)["ending"].tolist() == ["truncated", "goal_reached", "truncated"]


def test_observations_that_were_left_out_are_told_with_their_remedy(tmp_path: Path) -> None:
    write(tmp_path / FIRST, [("/trajectory", trajectory(2, 1, 5, steps=2, values=[], full_hash=77))])
    log = Log(tmp_path)
    with pytest.raises(Error, match="iteration 2, lane 1, episode 5: .*`goalward log restore RUN --out DIR`"):
        next(log.trajectories())
    assert log.episodes()["steps"].tolist() == [2]
    assert log.steps()["reward"].tolist() == [0, 1]


def test_an_unknown_ending_is_refused(tmp_path: Path) -> None:
    write(tmp_path / FIRST, [("/trajectory", trajectory(2, 1, 3, steps=1, ending=7))])
    with pytest.raises(Error, match=r"iteration 2, lane 1, episode 3: ending: expected .*, found 7"):
        Log(tmp_path).episodes()


def test_more_scores_than_observations_are_refused(tmp_path: Path) -> None:
    write(tmp_path / FIRST, [("/proximity/score", schema.Score(rewards=[0.5], proximity=[0.1, 0.2, 0.3]))])
    with pytest.raises(Error, match="proximity: expected at most 2 values, found 3"):
        Log(tmp_path).scores()


def test_a_trajectory_of_another_shape_is_refused(tmp_path: Path) -> None:
    write(tmp_path / FIRST, [("/trajectory", trajectory(0, 0, 0, steps=2, values=[1.0]))])
    with pytest.raises(Error, match=r"values: expected shape \(3, 3\), found 1 values"):
        next(Log(tmp_path).trajectories())


@pytest.mark.parametrize(("name", "words"), [(FIRST, "cut off"), (f"{FIRST}.active", "not sealed")])
def test_a_file_without_its_end_is_read_up_to_the_last_whole_record(
    tmp_path: Path, name: str, words: str
) -> None:
    file = tmp_path / name
    write(file, [("/trajectory", trajectory(0, 0, number, steps=20)) for number in range(40)])
    data = file.read_bytes()
    file.write_bytes(data[: len(data) // 2])
    log = Log(tmp_path)
    with pytest.warns(IncompleteLog, match=f"{name}: {words}: read up to byte"):
        found = [one.episode for one in log.trajectories()]
    assert 0 < len(found) < 40
    assert found == list(range(len(found)))
    assert words in log.endings[file].words
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert len(log.episodes()["steps"]) == len(found)


def test_a_file_that_grows_gives_more_each_time(tmp_path: Path) -> None:
    whole, file = tmp_path / "whole.mcap", tmp_path / f"{FIRST}.active"
    write(whole, [("/trajectory", trajectory(0, 0, number, steps=20)) for number in range(40)])
    data = whole.read_bytes()
    counts = []
    for keep in (0.0, 0.2, 0.4, 1.0):
        file.parent.mkdir(exist_ok=True)
        file.write_bytes(data[: int(keep * len(data))])
        write(tmp_path / UPDATES, [])
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", IncompleteLog)
            counts.append(len(Log(tmp_path).episodes()["steps"]))
    assert counts[0] == 0
    assert counts[0] < counts[1] < counts[2] < counts[3] == 40


def test_a_damaged_chunk_ends_its_file_and_the_next_one_is_read(run: Path) -> None:
    data = bytearray((run / FIRST).read_bytes())
    place = data.index(b"zstd") + 40  # in the first chunk
    data[place : place + 40] = bytes(40)
    (run / FIRST).write_bytes(data)
    log = Log(run)
    with pytest.warns(IncompleteLog, match="damaged behind byte"):
        found = [one.iteration for one in log.trajectories()]
    assert found == [1]
    assert not log.endings[run / FIRST].complete


def test_a_damaged_beginning_loses_its_file_alone(run: Path) -> None:
    data = bytearray((run / FIRST).read_bytes())
    data[8:60] = bytes(52)
    (run / FIRST).write_bytes(data)
    with pytest.warns(IncompleteLog, match="expected metadata `goalward.run`"):
        log = Log(run)
    assert [one.iteration for one in log.trajectories()] == [1]


def test_a_log_of_a_newer_format_says_so_also_while_it_is_written(tmp_path: Path) -> None:
    write(tmp_path / FIRST, [], seed=3)
    key = b"format_version\x01\x00\x00\x00"
    newer = (tmp_path / FIRST).read_bytes().replace(key + b"1", key + b"9")
    (tmp_path / FIRST).unlink()
    (tmp_path / f"{FIRST}.active").write_bytes(newer)
    with pytest.raises(Error, match="expected format version 1 or older, found 9"):
        Log(tmp_path)


def test_a_folder_without_a_log_is_refused(tmp_path: Path) -> None:
    with pytest.raises(Error, match="log: expected the folder of a log, found .*No such file"):
        Log(tmp_path)
    (tmp_path / "log").mkdir()
    with pytest.raises(Error, match=r"expected files such as trajectories-00000.mcap, found none"):
        Log(tmp_path)


def test_files_of_two_runs_are_refused(tmp_path: Path) -> None:
    write(tmp_path / FIRST, [], seed=3)
    write(tmp_path / SECOND, [], seed=4)
    with pytest.raises(Error, match="00001.mcap: expected seed 3 as in the run's first file, found 4"):
        Log(tmp_path)


def test_demonstrations_are_no_log(tmp_path: Path) -> None:
    (tmp_path / "log").mkdir()
    write_demonstrations(tmp_path / FIRST, [Episode(walk(3, 0))], REACH)
    with pytest.raises(Error, match=r"expected the log of a run, found goalward.demonstrations"):
        Log(tmp_path)
