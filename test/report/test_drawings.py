# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The small figures, and what the page's script is given of a run far from the origin."""

import base64
import re
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from twins.runs import SECOND, START, motion, samples

from trajeval_ros.conventional.sub_trajectories import BOX_QUANTILES, Box
from trajeval_ros.online.engine import Engine
from trajeval_ros.online.feed import feed
from trajeval_ros.online.parameters import complete
from trajeval_ros.report import Report, drawings
from trajeval_ros.report.payload import payload
from trajeval_ros.report.shown import shown


def box(length: float, median: float) -> Box:
    values = tuple(median * (0.5 + share) for share in BOX_QUANTILES)
    return Box(length, 100, values, tuple(np.radians(values).tolist()))


def places(svg: str) -> np.ndarray:
    """The medians' line, (n, 2)."""
    line = ElementTree.fromstring(svg).find("polyline")
    assert line is not None
    return np.array([point.split(",") for point in line.attrib["points"].split()], dtype=float)


@pytest.mark.parametrize("part", ["translation", "rotation"])
def test_a_power_law_is_a_straight_line(part: str) -> None:
    lengths = np.array([1.0, 2.0, 5.0, 10.0, 20.0, 50.0])
    found = [box(length, 0.01 * length**0.5) for length in lengths]
    boxes = drawings.boxes_of("a", "e0", found, part)
    # Degrees are degrees again.
    assert boxes.boxes[0][1]["median"] == pytest.approx(0.01)
    svg = drawings.growth("Title", "unit", "over", [boxes])
    x, y = places(svg).T
    slope = np.diff(y) / np.diff(x)
    np.testing.assert_allclose(slope, slope[0], rtol=0.02)
    assert slope[0] < 0.0  # up is less on a screen


def test_boxes_of_several_do_not_hide_one_another() -> None:
    found = [box(1.0, 0.01), box(10.0, 0.02)]
    several = [
        drawings.boxes_of(name, f"e{k}", found, "translation") for k, name in enumerate("ab")
    ]
    svg = drawings.growth("Title", "m", "over", several)
    lefts = re.findall(r'<rect x="([\d.]+)"', svg)
    assert len(set(lefts)) == len(lefts) == 4
    assert "a: 0.01 m over 1" in svg
    assert "b: 0.01 m over 1" in svg


def test_nothing_is_drawn_of_errors_that_are_none() -> None:
    none = drawings.boxes_of("a", "e0", [box(1.0, 0.0)], "translation")
    assert drawings.growth("Title", "m", "over", [none]) == ""


def test_what_is_not_white_stands_out() -> None:
    svg = drawings.whiteness("Title", "e3", [0.05, -0.3, 0.1], 0.2)
    assert svg.count("fill:var(--e3)") == 2
    assert svg.count("fill:var(--mark)") == 1
    assert "0.05, -0.30, 0.10" in svg


def test_a_grid_of_a_million_metres_keeps_millimetres() -> None:
    seconds = np.arange(0.0, 40.0, 0.05)
    stamps = START + np.rint(seconds * SECOND).astype(np.int64)
    far = np.array([458_000.0, 5_429_000.0, 160.0])
    poses = motion(seconds)
    poses[:, :3, 3] += far
    estimate = motion(seconds[5::4])
    estimate[:, :3, 3] += far + 0.003 * np.random.default_rng(1).normal(size=(len(estimate), 3))
    engine, report = Engine({}), Report(complete({}), {})
    for results in feed(engine, samples(stamps, poses), samples(stamps[5::4], estimate)):
        report.add(results)
    report.add_received(ground_truth=stamps, estimate=stamps[5::4])
    (one,) = shown({"a": report.run(engine.summary())})
    assert one.series is not None
    data = payload([one])
    origin = np.array(data["origin"])
    np.testing.assert_allclose(origin, far, atol=20.0)
    truth, off = (decoded(data["estimates"][0][name]) for name in ("truth", "off"))
    np.testing.assert_allclose(truth + origin, one.series.ground_truth, atol=1e-5)
    np.testing.assert_allclose(off, one.series.translation_axes, rtol=1e-6)
    # Near its origin a run keeps it.
    near = replace(one, series=replace(one.series, ground_truth=one.series.ground_truth - far))
    assert payload([near])["origin"] == [0.0, 0.0, 0.0]


def decoded(text: str) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), "<f4").astype(float).reshape(-1, 3)
