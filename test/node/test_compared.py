# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What ``~/comparison`` does where what it says cannot be said."""

from types import SimpleNamespace

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from harness import Graph
from twins.runs import FIXED, simulated

from trajeval_ros.node import compared
from trajeval_ros.online.parameters import complete
from trajeval_ros.runs.session import Session

pytestmark = pytest.mark.ros

NAMES = ("vins", "orb")


def test_a_defect_in_a_sentence_is_a_line_and_the_next_one_is_published(
    graph: Graph, monkeypatch: pytest.MonkeyPatch
) -> None:
    sources = {name: name for name in ("ground truth", *NAMES)}
    session = Session(complete({**FIXED, "estimates": NAMES}, NAMES), sources)
    runs = [simulated(seed, 20.0, (50.0, 10.0)) for seed in (1, 2)]
    session.feed(runs[0].ground_truth, *(run.estimate for run in runs))
    session.finish_all()
    estimates = [SimpleNamespace(latest=int(run.estimate.stamps[-1])) for run in runs]
    published = compared.Compared(graph.node, session, estimates)
    heard = graph.listen(DiagnosticArray, published.table.publisher.topic_name)
    graph.until(lambda: published.table.wanted, "a listener")

    with monkeypatch.context() as broken:
        broken.setattr(compared, "sentence", lambda comparison: 1 / 0)
        published.publish()
    assert not heard
    (line,) = session.defects
    assert "ZeroDivisionError" in line
    published.reset()
    published.publish(last=True)
    graph.until(lambda: heard, "the comparison")
    assert [status.name for status in heard[0].status] == ["vins vs orb"]
    assert session.defects == (line,)
