# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A session whose ground truth has no orientation."""

from pathlib import Path

import numpy as np
from twins.runs import simulated

from trajeval_ros.online.parameters import complete
from trajeval_ros.online.samples import PoseSamples
from trajeval_ros.runs.session import Session

SECOND = 1_000_000_000


def test_its_report_has_no_notice_of_likelihoods(tmp_path: Path) -> None:
    made = simulated(1, 20.0, (50.0, 10.0))
    truth = made.ground_truth
    values = complete({"gp.hyperparameters": "fixed", "output.directory": str(tmp_path)})
    session = Session(values, {"ground truth": "/prism", "estimate": "/odometry"})
    session.note_without_orientation(0)
    unturned = np.tile([0.0, 0.0, 0.0, 1.0], (len(truth), 1))
    session.feed(PoseSamples(truth.stamps, truth.positions, unturned), made.estimate)
    session.finish_all()
    codes = [notice.code for notice in session.engine.notices("estimate")]
    assert "first_order_strained" in codes, "there is nothing to leave out"
    session.save(last=True)
    session.close()
    assert "first order does not hold" not in (tmp_path / "report.html").read_text("utf-8")


def test_on_a_straight_line_it_says_what_is_left_out() -> None:
    seconds = np.arange(0.0, 20.0, 0.1)
    positions = np.stack([seconds, 0.0 * seconds, 0.0 * seconds], axis=1)
    unturned = np.tile([0.0, 0.0, 0.0, 1.0], (len(seconds), 1))
    samples = PoseSamples(SECOND + np.rint(seconds * SECOND).astype(np.int64), positions, unturned)
    sources = {"ground truth": "/prism", "estimate": "/odometry"}
    session = Session(complete({"gp.hyperparameters": "fixed"}), sources)
    session.note_without_orientation(0)
    session.feed(samples, samples)
    notices = session.finish_all()["estimate"].notices
    (text,) = (each.text for each in notices if each.code == "alignment_undetermined")
    assert "along a line alone" in text
    assert "the lever arm is not told" in text
    assert "conventional rotation error" not in text
