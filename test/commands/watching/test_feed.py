# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What browsers are sent, turn by turn, makes the state as it is."""

import json
from typing import Any

import numpy as np
import pytest
from browser import Known, whole
from hypothesis import given
from hypothesis import strategies as st

from trajeval_ros.commands.live import Health
from trajeval_ros.commands.watching.feed import Feed
from trajeval_ros.commands.watching.state import GROUND_TRUTH, Watched

SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND


def metrics(value: float, owner: str = "") -> dict[str, dict[str, str]]:
    prefix = f"{owner}: " if owner else ""
    return {
        f"{prefix}relative": {"chi2_per_dof": repr(value)},
        f"{prefix}conventional": {
            "ate_translation_rmse": repr(value),
            "ate_rotation_rmse": repr(0.01),
            "re_translation_rmse": repr(0.02),
            "re_delta": "1.0",
            "re_unit": "s",
        },
        f"{prefix}window": {
            "duration": "30.0",
            "absolute_noise_equivalent_translation_std": repr(0.5 * value),
        },
        f"{prefix}coverage": {"time": "1.0", "duration": "12.0"},
    }


def shown(watched: Watched) -> dict[str, Any]:
    return json.loads(Feed(watched).whole)


def test_figures_are_those_of_the_topic_and_their_words() -> None:
    watched = Watched("/evaluator")
    watched.take_metrics(START, metrics(0.0123456789))
    sections = shown(watched)["sections"]
    assert sections["run"]["estimates"] == ["estimate"]
    assert sections["run"]["start"] == START / SECOND
    estimate = sections["estimate/estimate"]
    assert estimate["figures"]["conventional"]["ate_translation_rmse"] == 0.0123456789
    assert estimate["figures"]["conventional"]["re_unit"] == "s"
    tiles = {tile["title"]: (tile["value"], tile["remark"]) for tile in estimate["tiles"]}
    assert tiles == {
        "ATE": ("12.3 mm", "0.573°, aligned, whole run"),
        "RE": ("20 mm", "over 1 s, whole run"),
        "Accuracy": ("6.17 mm", "noise-equivalent, last 30 s"),
        "Coverage": ("100 %", "of 12 s"),
    }


def test_several_stand_under_their_names_in_the_nodes_order() -> None:
    watched = Watched("/evaluator")
    watched.name_estimates(["orb", "vins"], several=True)
    for name in ("orb", "vins"):
        watched.take_metrics(START, metrics(0.1, name))
    for name in ("ground truth", "vins", "orb", "synchronization"):
        watched.take_health(name, Health(0, "well"))
    watched.take_comparison({"vins vs orb": "no difference to be told"})
    sections = shown(watched)["sections"]
    assert sections["run"]["estimates"] == ["vins", "orb"]
    assert set(sections["estimate/orb"]["figures"]) == {
        "relative",
        "conventional",
        "window",
        "coverage",
    }
    assert sections["comparison"] == [{"pair": "vins vs orb", "text": "no difference to be told"}]


def test_a_path_stands_beside_the_ground_truth_at_its_stamps() -> None:
    watched = Watched("/evaluator")
    watched.take_metrics(START, metrics(0.1))
    stamps = [START + number * SECOND for number in range(5)]
    truth = np.arange(15.0).reshape(5, 3)
    watched.take_path(GROUND_TRUTH, truth, stamps)
    watched.take_path("estimate", truth[:-1] + 0.5 + [3.0, 4.0, 0.0], stamps[:-1])
    halfway = [stamp + SECOND // 2 for stamp in stamps[:-1]]
    watched.name_estimates(["estimate", "other"], several=True)
    watched.take_path("other", truth[:-1] + 1.5, halfway)
    sections = shown(watched)["sections"]
    assert sections["path/ground_truth"]["positions"] == truth.ravel().tolist()
    path = sections["path/estimate"]
    assert path["truth"] == truth[:-1].ravel().tolist()
    np.testing.assert_allclose(path["error"], np.linalg.norm([3.5, 4.5, 0.5]), rtol=1e-3)
    np.testing.assert_allclose(sections["path/other"]["error"], 0.0, atol=1e-9)


def test_what_is_not_finite_is_not_drawn() -> None:
    watched = Watched("/evaluator")
    watched.take_metrics(START, metrics(0.1))
    positions = np.arange(12.0).reshape(4, 3)
    bad = positions.copy()
    bad[1, 0], bad[2, 2] = np.nan, np.inf
    stamps = [START + number * SECOND for number in range(4)]
    for name in (GROUND_TRUTH, "estimate"):
        watched.take_path(name, bad, stamps)
    watched.take_path("estimate", np.full((1, 3), np.nan), stamps[:1])
    sections = shown(watched)["sections"]
    assert sections["path/estimate"]["seconds"] == [0.0, 3.0]
    assert sections["path/ground_truth"]["positions"] == positions[[0, 3]].ravel().tolist()


@pytest.mark.parametrize("text", ["nan", "-inf", "", "no number"])
def test_a_figure_that_is_no_number_is_a_dash(text: str) -> None:
    watched = Watched("/evaluator")
    conventional = {"ate_translation_rmse": text, "re_delta": text, "re_translation_rmse": "0.25"}
    coverage = {"time": text, "duration": text}
    window = {"duration": text, "absolute_noise_equivalent_translation_std": text}
    watched.take_metrics(
        START, {"conventional": conventional, "coverage": coverage, "window": window}
    )
    message = shown(watched)
    section = message["sections"]["estimate/estimate"]
    assert [tile["value"] for tile in section["tiles"]] == ["–", "250 mm", "–", "–"]
    assert section["figures"]["conventional"]["ate_translation_rmse"] == text
    curves = message["curves"]["figures/estimate"]
    row = dict(zip(curves["columns"], curves["rows"][0], strict=True))
    assert (row["ate_translation"], row["re_translation"]) == (None, 0.25)


def test_a_run_that_began_earlier_is_told_anew_from_there() -> None:
    watched = Watched("/evaluator")
    feed = Feed(watched)
    known = Known()
    watched.take_metrics(START + 20 * SECOND, metrics(0.1))
    watched.take_errors("estimate", [(START + 20 * SECOND, [0.1, 0.1, 0.1, 0.1])])
    watched.take_health("estimate", Health(1, "silent"))
    assert feed.turn()
    known.take(json.loads(feed.change))
    # The path, which is latched, knows of what was before us.
    stamps = [START, START + 10 * SECOND]
    watched.take_path(GROUND_TRUTH, np.zeros((2, 3)), stamps)
    assert feed.turn()
    known.take(json.loads(feed.change))
    assert known.state == whole(json.loads(feed.whole))
    assert known.sections["run"]["start"] == START / SECOND
    assert known.sections["path/ground_truth"]["seconds"] == [0.0, 10.0]
    assert known.sections["health"]["events"][0]["seconds"] == 20.0
    assert known.curves["errors/estimate"]["rows"] == [[20.0, 0.1, 0.1, 0.1, 0.1]]
    assert known.curves["figures/estimate"]["rows"][0][0] == 20.0


def test_a_stamp_that_goes_back_begins_another_run() -> None:
    watched = Watched("/evaluator")
    watched.take_metrics(START + SECOND, metrics(0.1))
    watched.take_errors("estimate", [(START + SECOND, [0.1, 0.1, 0.1, 0.1])])
    watched.take_metrics(START, metrics(0.2))
    message = shown(watched)
    assert message["run"] == 1
    assert message["sections"]["run"]["number"] == 1
    assert message["curves"]["errors/estimate"]["rows"] == []
    assert [row[0] for row in message["curves"]["figures/estimate"]["rows"]] == [0.0]


ACTION = st.tuples(
    st.sampled_from(["errors", "metrics", "path", "health", "over", "turn", "turn"]),
    st.floats(0.0, 10.0),
)


@given(st.lists(ACTION, max_size=120), st.integers(1, 3))
def test_changes_turn_by_turn_make_the_whole(actions: list[tuple[str, float]], every: int) -> None:
    watched = Watched("/evaluator")
    feed = Feed(watched)
    known, sleepy = Known(), Known()
    known.take(json.loads(feed.whole))
    turns = 0
    stamp = START
    for action, value in actions:
        stamp += SECOND // 10
        if action == "errors":
            # Many at a time, so that rows are merged.
            for _ in range(700):
                stamp += SECOND // 100
                watched.take_errors("estimate", [(stamp, [value, None, 0.1, 0.2])])
        elif action == "metrics":
            watched.take_metrics(stamp, metrics(value))
        elif action == "path":
            watched.take_path(GROUND_TRUTH, np.full((2, 3), value), [stamp, stamp + 1])
        elif action == "health":
            watched.take_health("estimate", Health(int(value) % 2, f"{value}"))
        elif action == "over":
            watched.start_over()
        elif feed.turn():
            turns += 1
            known.take(json.loads(feed.change))
            assert known.state == whole(json.loads(feed.whole))
            if turns % every == 0:
                # One that sleeps now and then is told all when it wakes.
                sleepy.take(json.loads(feed.whole))
                assert sleepy.state == known.state
    if feed.turn():
        known.take(json.loads(feed.change))
    assert known.state == whole(json.loads(feed.whole))
    assert not feed.turn()


def test_the_whole_is_made_once_and_is_bounded() -> None:
    watched = Watched("/evaluator")
    watched.take_metrics(START, metrics(0.1))
    stamps = range(START, START + 100_000 * SECOND // 100, SECOND // 100)
    watched.take_errors("estimate", ((stamp, [0.123456789] * 4) for stamp in stamps))
    feed = Feed(watched)
    assert feed.whole is feed.whole
    assert len(feed.whole) < 200_000
    assert json.loads(feed.whole)["curves"]["errors/estimate"]["columns"][0] == "seconds"


def test_the_same_health_is_no_change() -> None:
    watched = Watched("/evaluator")
    watched.take_health("estimate", Health(0, "20 messages/s"))
    feed = Feed(watched)
    watched.take_health("estimate", Health(0, "20 messages/s", {"received": "7"}))
    assert not feed.turn()
    watched.take_health("estimate", Health(1, "silent"))
    assert feed.turn()


@pytest.mark.parametrize("nothing", [{}, {"relative": {}}])
def test_a_message_without_figures_is_taken(nothing: dict[str, dict[str, str]]) -> None:
    watched = Watched("/evaluator")
    watched.take_metrics(START, nothing)
    tiles = shown(watched)["sections"]["estimate/estimate"]["tiles"]
    assert [tile["value"] for tile in tiles] == ["–"] * 4
