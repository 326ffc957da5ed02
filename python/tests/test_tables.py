"""Tests of data sets in plain tables: NumPy archives and CSV files."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from walks import REACH, ROOMS, rooms, walk

from goalward import Error
from goalward.demonstrations import Loaded, load


def states(loaded: Loaded) -> list[Any]:
    return [np.asarray(episode.observations) for episode in loaded.episodes]


def saved(folder: Path, **arrays: Any) -> Path:
    np.savez(folder / "data.npz", **arrays)
    return folder / "data.npz"


def test_stacked_arrays_are_episodes(tmp_path: Path) -> None:
    stack = np.stack([walk(6, number) for number in range(3)])
    source = saved(tmp_path, x=stack[..., :1], yz=stack[..., 1:], actions=np.zeros((3, 6, 2)))
    for number, found in enumerate(states(load(source, REACH, success="all"))):
        np.testing.assert_array_equal(found, walk(6, number))


def test_padding_behind_an_episode_is_left_out(tmp_path: Path) -> None:
    stack = np.full((2, 9, 3), np.nan)
    stack[0, :5], stack[1] = walk(4, 0), walk(8, 1)
    success = np.zeros((2, 8))
    success[0, 3] = success[1, 5] = 1
    source = saved(tmp_path, states=stack, lengths=[5, 9], success=success)
    first, second = states(load(source, REACH))
    np.testing.assert_array_equal(first, walk(4, 0))
    np.testing.assert_array_equal(second, walk(8, 1)[:7])


@pytest.mark.parametrize("keys", [None, ["states"]])
def test_a_goal_of_each_episode_is_no_observation(tmp_path: Path, keys: list[str] | None) -> None:
    source = saved(tmp_path, states=np.stack([walk(4, 0), walk(4, 1)]), goal=np.zeros((2, 7)))
    first, second = states(load(source, REACH, keys=keys, success="all"))
    np.testing.assert_array_equal(first, walk(4, 0))
    np.testing.assert_array_equal(second, walk(4, 1))


def test_the_arrays_of_the_keys_have_a_row_for_each_observation(tmp_path: Path) -> None:
    arrays = {"states": np.stack([walk(4, 0), walk(4, 1)]), "images": np.zeros((2, 9, 4, 4))}
    found = states(load(saved(tmp_path, **arrays), REACH, keys=["states"], success="all"))
    np.testing.assert_array_equal(found, [walk(4, 0), walk(4, 1)])


def test_single_numbers_are_no_goal_beside_the_actions_between_them(tmp_path: Path) -> None:
    stack = np.stack([walk(6, number) for number in range(3)])
    columns = dict(zip("xyz", np.moveaxis(stack, 2, 0), strict=True))
    source = saved(tmp_path, actions=np.zeros((3, 6, 2)), **columns)
    np.testing.assert_array_equal(states(load(source, REACH, success="all")), stack)


def test_arrays_with_one_episode_behind_another_are_cut_at_their_ends(tmp_path: Path) -> None:
    rows = np.concatenate([walk(4, 0), walk(7, 1), walk(5, 2)])
    source = saved(tmp_path, states=rows, episode_ends=[5, 13, 19], success=[True, False, True])
    loaded = load(source, REACH)
    first, third = states(loaded)
    np.testing.assert_array_equal(first, walk(4, 0))
    np.testing.assert_array_equal(third, walk(5, 2))
    assert loaded.left_out == 1


def test_a_grid_is_read_from_an_archive(tmp_path: Path) -> None:
    source = saved(tmp_path, grid=np.stack([rooms(6, 0), rooms(6, 1)]))
    np.testing.assert_array_equal(states(load(source, ROOMS, success="all"))[1], rooms(6, 1))


@pytest.mark.parametrize(
    ("arrays", "expected"),
    [
        ({"states": np.zeros((4, 3)), "episode_ends": [3, 2]}, "episode_ends: expected rows that grow"),
        ({"states": np.zeros((4, 3)), "episode_ends": [5]}, "expected arrays of 5 rows"),
        (
            {"states": np.zeros((4, 3)), "episode_ends": [1.5, 4]},
            r"episode_ends\[0\]: expected a whole number",
        ),
        ({"states": np.zeros((1, 4, 3)), "lengths": [np.nan]}, r"lengths\[0\]: .*, found nan"),
        ({"states": np.zeros((2, 4, 3)), "lengths": [4]}, "lengths: expected 2 numbers, found 1"),
        (
            {"states": np.zeros((2, 4, 3)), "lengths": [4, 5]},
            "episode 1: lengths: expected a number from 1 to 4, found 5",
        ),
        ({"states": np.array(["a"])}, "expected arrays of numbers, found none"),
        ({"states": np.zeros((0, 4, 3))}, "expected at least one episode that reaches the goal, found no"),
    ],
)
def test_arrays_that_do_not_fit_together_are_refused(
    tmp_path: Path, arrays: dict[str, Any], expected: str
) -> None:
    with pytest.raises(Error, match=expected):
        load(saved(tmp_path, **arrays), REACH, success="all")


@pytest.mark.parametrize("success", [None, "all"])
@pytest.mark.parametrize("length", [0, -1])
def test_an_episode_without_observations_is_refused(tmp_path: Path, success: str | None, length: int) -> None:
    source = saved(tmp_path, states=np.zeros((3, 5, 3)), success=[0, 1, 0], lengths=[5, length, 3])
    with pytest.raises(Error, match=f"episode 1: lengths: expected a number from 1 to 5, found {length}"):
        load(source, REACH, success=success)


def test_no_demonstration_at_all_is_not_asked_for(tmp_path: Path) -> None:
    source = saved(tmp_path, states=np.stack([walk(6, 0)]))
    with pytest.raises(Error, match="episodes: expected a number from 1, found 0"):
        load(source, REACH, success="all", episodes=0)


def test_a_damaged_archive_is_refused(tmp_path: Path) -> None:
    source = saved(tmp_path, states=np.zeros((2, 4, 3)))
    source.write_bytes(source.read_bytes()[:100])
    with pytest.raises(Error, match="data.npz: expected a NumPy archive"):
        load(source, REACH, success="all")


def table(folder: Path, *lines: str) -> Path:
    source = folder / "data.csv"
    source.write_text("\n".join(lines) + "\n")
    return source


def test_columns_of_a_table_are_observations(tmp_path: Path) -> None:
    source = table(
        tmp_path,
        "episode,note,z,x,y,success",
        "a,start,3,1,2,false",
        "b,start,6,4,5,False",
        "a,move,9,7,8,true",
        "b,move,12,10,11,false",
        "a,late,15,13,14,false",
    )
    loaded = load(source, REACH, keys=["x", "y", "z"])
    assert [found.tolist() for found in states(loaded)] == [[[1, 2, 3], [7, 8, 9]]]
    assert loaded.left_out == 1


def test_columns_of_a_table_are_actions(tmp_path: Path) -> None:
    source = table(tmp_path, "episode,x,y,z,u,v", "0,1,2,3,0.5,-1", "0,4,5,6,1,0", "0,7,8,9,,")
    [episode] = load(source, REACH, success="all", actions=["v", "u"]).episodes
    np.testing.assert_array_equal(np.asarray(episode.actions), [[-1, 0.5], [0, 1]])
    np.testing.assert_array_equal(np.asarray(episode.observations), [[1, 2, 3], [4, 5, 6], [7, 8, 9]])


def test_without_keys_every_column_of_numbers_but_success_is_taken(tmp_path: Path) -> None:
    source = table(tmp_path, "episode_id,x,y,z,success", "0,1,2,3,0", "0,4,5,6,1")
    assert states(load(source, REACH))[0].tolist() == [[1, 2, 3], [4, 5, 6]]


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        (["x,y,z", "1,2,3"], "expected a column episode or episode_id or episode_index, found x, y, z"),
        (["episode,x,y,z", "0,1,2,3", "0,1,2"], "line 3: expected 4 columns, found 3"),
        (["episode,x,y,z", "", '0,"1', '",2,3', "", "0,1,2"], "line 6: expected 4 columns, found 3"),
        (["episode,x,x,z", "0,1,2,3"], "expected columns of differing names, found episode, x, x, z"),
        (["episode,x,y,z"], "expected rows below the header, found none"),
        (
            ["episode,x,y,z", "0,1,2,3", "0,1,,3"],
            r"observations\[1, 1\]: expected a finite float32, found nan",
        ),
        (["episode,x,y", "0,1,2"], r"expected 3 numbers, the observation of reach, found x \(1\), y \(1\)"),
    ],
)
def test_a_table_that_does_not_fit_is_refused(tmp_path: Path, lines: list[str], expected: str) -> None:
    with pytest.raises(Error, match=expected):
        load(table(tmp_path, *lines), REACH, success="all")


def test_a_table_of_other_bytes_is_refused(tmp_path: Path) -> None:
    source = tmp_path / "data.csv"
    source.write_bytes(b"\xff\xfe\x00episode")
    with pytest.raises(Error, match="expected a CSV file"):
        load(source, REACH, success="all")
