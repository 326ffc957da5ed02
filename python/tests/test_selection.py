"""Tests of what is taken from a recording: its keys, the part up to the goal, and the check of labels."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import ArrayLike
from walks import REACH, ROOMS, rooms, walk

from goalward import Error
from goalward.demonstrations.recordings import Recording, of_states
from goalward.demonstrations.selection import Selection

LABELED = replace(REACH, labels=("goal[0]", "goal[1]", "speed"))


def recording(success: ArrayLike | None = None, steps: int = 5) -> Recording:
    states = walk(steps, 0)
    signals = {} if success is None else {"success": np.asarray(success)}
    return Recording("7", {"speed": states[:, 2], "goal": states[:, :2]}, signals)


def lengths(selection: Selection, *recordings: Recording) -> list[int | None]:
    """Return the number of steps of each episode; None for one that is left out."""
    episodes = selection.episodes(recordings)
    return [None if episode is None else len(np.asarray(episode.observations)) - 1 for episode in episodes]


def refusal(selection: Selection, *recordings: Recording) -> str:
    with pytest.raises(Error) as error:
        list(selection.episodes(recordings))
    return str(error.value)


def test_keys_are_joined_in_their_order() -> None:
    [episode] = Selection(REACH, ["goal", "speed"], "all").episodes([recording()])
    assert episode is not None
    np.testing.assert_array_equal(episode.observations, walk(5, 0))


def test_without_keys_the_data_set_says_the_order() -> None:
    [episode] = Selection(REACH, None, "all").episodes([recording()])
    assert episode is not None
    np.testing.assert_array_equal(episode.observations, walk(5, 0)[:, [2, 0, 1]])


def test_without_keys_what_tells_success_is_no_observation() -> None:
    states = walk(5, 0)
    table = {"states": states, "success": np.array([0, 0, 0, 1, 1, 1])}
    selection = Selection(REACH, None, "all", known_success=("success",))
    assert lengths(selection, Recording("7", table, table)) == [5]


def test_a_transposed_grid_is_refused() -> None:
    turned = Recording("0", {"grid": np.swapaxes(rooms(3, 0), 1, 2)})
    assert "expected shape" in refusal(Selection(ROOMS, None, "all"), turned)


def test_a_grid_may_come_row_by_row() -> None:
    flat = Recording("0", {"grid": rooms(3, 0).reshape(4, 20)})
    [episode] = Selection(ROOMS, None, "all").episodes([flat])
    assert episode is not None
    np.testing.assert_array_equal(episode.observations, rooms(3, 0))


def test_a_missing_key_is_refused_with_those_there_are() -> None:
    expected = "episode 7: keys: expected `angle`, found speed (1), goal (2)"
    assert refusal(Selection(REACH, ["angle"], "all"), recording()) == expected


def test_another_length_is_refused_with_that_of_each_key() -> None:
    expected = "episode 7: keys: expected 3 numbers, the observation of reach, found goal (2)"
    assert refusal(Selection(REACH, ["goal"], "all"), recording()) == expected


def test_the_only_key_that_fits_is_named() -> None:
    table = Recording("7", {"observations": np.zeros((5, 3)), "actions": np.zeros((5, 2))})
    words = refusal(Selection(REACH, None, "all"), table)
    assert words.endswith("found observations (3), actions (2); --keys observations fits")


def test_keys_of_differing_rows_are_refused() -> None:
    uneven = Recording("7", {"a": np.zeros((4, 1)), "b": np.zeros((5, 2))})
    expected = "episode 7: expected keys with as many rows, found a (4), b (5)"
    assert refusal(Selection(REACH, None, "all"), uneven) == expected


def test_parts_that_match_the_labels_pass() -> None:
    assert lengths(Selection(LABELED, ["goal", "speed"], "all"), recording()) == [5]


def test_columns_that_are_named_like_the_labels_pass() -> None:
    columns = Recording("7", {label: np.zeros((6, 1)) for label in LABELED.labels})
    assert lengths(Selection(LABELED, None, "all"), columns) == [5]
    turned = Recording("7", {label: np.zeros((6, 1)) for label in reversed(LABELED.labels)})
    assert refusal(Selection(LABELED, None, "all"), turned).startswith("labels: part 1: expected goal (2)")


def test_the_first_part_that_differs_from_the_labels_is_named() -> None:
    words = refusal(Selection(LABELED, ["speed", "goal"], "all"), recording())
    assert words.startswith("labels: part 1: expected goal (2), found speed (1)")


def test_differing_labels_can_be_ignored() -> None:
    selection = Selection(LABELED, ["speed", "goal"], "all", labels="ignore")
    assert lengths(selection, recording()) == [5]


@pytest.mark.parametrize(
    ("success", "steps"),
    [
        ([0, 0, 0, 1, 1, 0], 3),  # one value for each observation
        ([0, 0, 0, 1, 1], 4),  # one value for each step
        ([True], 5),  # one value for the episode
        (True, 5),
        ([0, 0, 0, 0, 0], None),
        ([False], None),
        ([1, 0, 0, 0, 0, 1], None),  # it begins at the goal
    ],
)
def test_an_episode_ends_at_its_first_success(success: ArrayLike, steps: int | None) -> None:
    assert lengths(Selection(REACH, None, "success"), recording(success)) == [steps]


def test_the_key_of_the_format_tells_success() -> None:
    selection = Selection(REACH, None, None, known_success=("won", "success"))
    assert lengths(selection, recording([0, 1, 0, 0, 0])) == [2]


def test_success_has_to_be_told() -> None:
    words = refusal(Selection(REACH, None, None), recording([0, 0, 0, 0, 1]))
    assert words.startswith("success: expected `all`")
    assert words.endswith("found neither; possible success keys: success")


def test_a_signal_that_is_not_there_is_refused() -> None:
    words = refusal(Selection(REACH, None, "won"), recording([True]))
    assert words == "episode 7: success: expected `all` or a success key (success), found `won`"


def test_a_signal_of_other_numbers_is_refused() -> None:
    words = refusal(Selection(REACH, None, "success"), recording([0, 0.5, 0, 0, 1]))
    assert words.startswith("episode 7: success: expected 0 and 1, found 0.5")


def test_a_signal_of_another_length_is_refused() -> None:
    words = refusal(Selection(REACH, None, "success"), recording([0, 0, 1]))
    assert "expected 6 values, one for each observation, one fewer, or a single one, found 3" in words


@pytest.mark.parametrize("rows", [5, 6])
def test_actions_are_those_of_the_steps_that_are_taken(rows: int) -> None:
    success, moves = [0, 0, 0, 1, 1, 0], np.linspace(-1, 1, 2 * rows).reshape(rows, 2)
    table = Recording("7", recording(success).observations, {"success": np.array(success)}, {"moves": moves})
    [episode] = Selection(REACH, None, "success", actions=["moves"]).episodes([table])
    assert episode is not None
    np.testing.assert_array_equal(np.asarray(episode.actions), moves[:3])


def test_choices_are_no_rows() -> None:
    table = Recording("0", {"grid": rooms(3, 0)}, actions={"choice": np.array([[2], [0], [3]])})
    [episode] = Selection(ROOMS, None, "all", actions=["choice"]).episodes([table])
    assert episode is not None
    np.testing.assert_array_equal(np.asarray(episode.actions), [2, 0, 3])


def test_actions_that_are_missing_or_of_other_steps_are_refused() -> None:
    selection = Selection(REACH, None, "all", actions=["moves"])
    assert refusal(selection, recording()) == "episode 7: actions: expected `moves`, found none"
    short = Recording("7", recording().observations, actions={"moves": np.zeros((4, 2))})
    expected = "episode 7: actions: expected 5 rows of `moves`, one for each step, or one more, found 4"
    assert refusal(selection, short) == expected


def test_nan_is_refused_with_its_place() -> None:
    states = walk(5, 0)
    states[4, 1] = np.nan
    words = refusal(Selection(REACH, None, "all"), Recording("7", {"x": states}))
    assert words == "episode 7: observations[4, 1]: expected a finite float32, found nan"


def test_an_episode_longer_than_the_horizon_is_refused() -> None:
    words = refusal(Selection(REACH, None, "all"), recording(steps=21))
    assert words == "episode 7: steps: expected 1 to 20, the horizon of reach, found 21"


def test_a_long_episode_with_an_early_success_fits() -> None:
    success = np.arange(41) >= 10
    assert lengths(Selection(REACH, None, "success"), recording(success, steps=40)) == [10]


@pytest.mark.parametrize(
    ("steps", "states"), [([0, 0, 1], [0, 0, 1]), ([0, 1, 0], [0, 0, 1]), ([1, 0, 0], [0, 1, 0]), ([1], [0])]
)
def test_a_signal_of_steps_counts_for_the_state_behind(steps: list[int], states: list[int]) -> None:
    assert of_states(np.array(steps)).tolist() == states
