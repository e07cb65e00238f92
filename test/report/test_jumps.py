# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Where the ground truth jumps the estimate is not to blame."""

from __future__ import annotations

from typing import Any

from trajeval_ros.report.answers import _jumps
from trajeval_ros.report.jumps import of_ground_truth
from trajeval_ros.runs.several import jumps_of_all, shared_jumps

SECOND = 1_000_000_000


def jump(seconds: float, metres: float) -> dict[str, Any]:
    return {"stamp": round(seconds * SECOND), "translation": metres, "rotation": 0.01}


def summary(*jumps: dict[str, Any], clock: float = 0.0, at: tuple[float, ...] = ()) -> Any:
    fault = {"code": "origin_jump", "stamps": [round(each * SECOND) for each in at]}
    return {
        "ground_truth": {"faults": [{"code": "outliers"}, fault]},
        "error_model": {"jumps": list(jumps), "clock_offset": {"value": clock}},
    }


def test_a_jump_is_the_ground_truth_s_where_that_jumps() -> None:
    one = summary(jump(10.0, 0.3), jump(44.9, 0.13), jump(60.0, 0.2), clock=0.2, at=(45.0, 60.6))
    blamed = of_ground_truth(one["error_model"]["jumps"], one)
    assert blamed == [False, True, False]
    ((title, text),) = _jumps(one["error_model"]["jumps"], blamed, 5.0)
    assert title == "Jumps"
    assert (
        text
        == "2, the largest 300 mm, 0.57 deg at 5.0 s; 1 more where the ground truth itself jumps"
    )
    ((_, text),) = _jumps(one["error_model"]["jumps"][1:2], [True], 0.0)
    assert text == "1, the largest 130 mm, 0.57 deg at 44.9 s, where the ground truth itself jumps"
    assert _jumps([], [], 0.0) == []
    large = _jumps([jump(1.0, 1.47)], [False], 0.0)
    assert "1.47 m" in large[0][1]


def test_two_that_jump_alike_share_it() -> None:
    places = (10.0, 20.0, 30.0)
    one = summary(*(jump(at, 0.1) for at in places), jump(40.0, 0.2))
    # The other's clock is late, it misses one, and has a larger one at the same moment.
    late = [jump(at - 0.5, 0.11) for at in places]
    other = summary(*late, jump(39.5, 0.5), jump(70.0, 0.1), clock=0.5)
    assert [stamp // SECOND for stamp, _ in shared_jumps(one, other)] == [10, 20, 30]
    (cause,) = jumps_of_all({"a": one, "b": other})
    assert cause.code == "ground_truth_jumps"
    assert "a and b jump at the same 3 moments" in cause.text
    assert jumps_of_all({"a": one, "b": summary(*late[:2], clock=0.5)}) == ()
    assert jumps_of_all({"a": one, "b": {"ground_truth": {}, "error_model": None}}) == ()
