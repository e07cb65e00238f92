# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The node with fits or lessons that take as long as a test wants.

``held_up.py fit|lesson FOLDER [arguments of the node]``: each makes the file ``begun`` in FOLDER
and computes on until ``over`` is there, before what it does otherwise. Of lessons, all but the
first.
"""

import itertools
import sys
from pathlib import Path

import numpy as np

from trajeval_ros.error_model import running
from trajeval_ros.ground_truth.lessons import Lesson
from trajeval_ros.node.main import main


def hold_up(folder: Path) -> None:
    """Compute as a fit does: small arrays, the interpreter never left."""
    (folder / "begun").touch()
    matrix = np.eye(6)
    for turn in itertools.count():
        matrix = matrix @ matrix
        if turn % 1000 == 0 and (folder / "over").exists():
            break


def run() -> int:
    what, place, *arguments = sys.argv[1:]
    folder = Path(place)
    fit, learned = running.fit_poses, Lesson.learned

    def fit_poses(poses, **how):
        hold_up(folder)
        return fit(poses, **how)

    def slowly_learned(lesson):
        if lesson.before is not None:
            hold_up(folder)
        return learned(lesson)

    if what == "fit":
        running.fit_poses = fit_poses
    else:
        Lesson.learned = slowly_learned
    return main(["evaluator", *arguments])


if __name__ == "__main__":
    sys.exit(run())
