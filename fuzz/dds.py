# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``python -m fuzz.dds --minutes M``: the node's own process, fed over DDS faster than time goes.

Twice the stamps jump back; a publisher goes and comes back; for a while the disk takes nothing.
The process's memory and CPU time a message are held to be flat, its accounts to be exact.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import QoSProfile

from fuzz.oracle import Failure, check_accounts, require
from fuzz.soak import CHUNK, Tenth, judge, samples, table
from trajeval_ros.commands.console import Progress
from trajeval_ros.commands.domain import own_domain
from trajeval_ros.online.samples import PoseSamples

TOPICS = {"ground_truth": "/soak/ground_truth", "estimate": "/soak/estimate"}
_RATES, _STDS = (20.0, 2.0), (2e-3, 1e-2)
# As shares of the run. Rows wait for a full disk, and a run ends, before the tenth that others are
# compared with: for the results of a longer run malloc keeps some more, and none of it is in use.
_JUMPS, _RETURN, _FULL = (0.05, 0.15), 0.35, (0.08, 0.12)
_EARLY = 2
_PATIENCE = 60.0
# The report's history is full after half an hour of a run, and that tenth is to be after that.
_HOURS = 4.0


class Feeder:
    """Publishes, and knows how many messages of each topic it has published."""

    def __init__(self, node: Node) -> None:
        """Start with both publishers."""
        self._node = node
        self._rng = np.random.default_rng(1)
        self._publishers = [self._publisher(topic) for topic in TOPICS.values()]
        self.begin, self.fed = 0.0, [0, 0]

    def _publisher(self, topic: str) -> Any:
        return self._node.create_publisher(PoseStamped, topic, QoSProfile(depth=10_000))

    def until_heard(self) -> None:
        """Wait until the evaluator subscribes to both."""
        deadline = time.monotonic() + _PATIENCE
        while not all(each.get_subscription_count() for each in self._publishers):
            require(time.monotonic() < deadline, "nobody listens")
            time.sleep(0.05)

    def until_acknowledged(self) -> None:
        """Wait until the evaluator has every message in its queue."""
        for each in self._publishers:
            require(each.wait_for_all_acked(Duration(seconds=_PATIENCE)), "it does not acknowledge")

    def come_back(self) -> None:
        """Let the estimate's publisher go, once all has arrived, and a new one come."""
        self.until_acknowledged()
        self._node.destroy_publisher(self._publishers[1])
        self._publishers[1] = self._publisher(TOPICS["estimate"])
        self.until_heard()

    def jump_back(self) -> None:
        """Let the stamps begin anew."""
        self.begin = 0.0

    def chunk(self, seconds: float) -> int:
        """Publish a chunk of stamps within so many seconds; return how many messages."""
        made = [samples(self._rng, self.begin, r, s) for r, s in zip(_RATES, _STDS, strict=True)]
        order = np.argsort(np.concatenate([each.stamps for each in made]), kind="stable")
        begin, count = time.monotonic(), len(order)
        messages = [(k, m) for k, each in enumerate(made) for m in _messages(each)]
        for number, index in enumerate(order.tolist()):
            topic, message = messages[index]
            self._publishers[topic].publish(message)
            time.sleep(max(begin + seconds * number / count - time.monotonic(), 0.0))
        self.begin += CHUNK
        self.fed = [a + len(b) for a, b in zip(self.fed, made, strict=True)]
        return count


def _messages(made: PoseSamples) -> list[PoseStamped]:
    found = []
    rows = np.concatenate([made.positions, made.quaternions], axis=1).tolist()
    for stamp, (x, y, z, *q) in zip(made.stamps.tolist(), rows, strict=True):
        message = PoseStamped()
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 1_000_000_000)
        position, turn = message.pose.position, message.pose.orientation
        position.x, position.y, position.z = x, y, z
        turn.x, turn.y, turn.z, turn.w = q
        found.append(message)
    return found


def _cpu(pid: int) -> float:
    """CPU time of a process, s."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _resident(pid: int) -> int:
    pages = int(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


def _started(folder: Path, domain: int) -> subprocess.Popen[bytes]:
    parameters = [f"output.directory:={folder / 'output'}"]
    parameters += [f"{name}.topic:={topic}" for name, topic in TOPICS.items()]
    arguments = [each for text in parameters for each in ("-p", text)]
    with (folder / "log").open("wb") as log:
        return subprocess.Popen(
            [sys.executable, "-m", "trajeval_ros.node.main", "--ros-args", *arguments],
            env={**os.environ, "ROS_DOMAIN_ID": str(domain)},
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
        )


def run(minutes: float, speed: float, folder: Path, domain: int) -> list[Tenth]:
    """Run, and return its tenths; raises :class:`~fuzz.oracle.Failure` where something is wrong."""
    count = max(round(60.0 * minutes * speed / CHUNK), 40)
    marks = {round(share * count): share for share in (*_JUMPS, _RETURN, *_FULL)}
    rclpy.init(args=[], domain_id=domain)
    child = _started(folder, domain)
    tenths = [Tenth() for _ in range(10)]
    try:
        feeder = Feeder(rclpy.create_node("soak"))
        feeder.until_heard()
        progress = Progress("soaking", count, "chunks")
        before = _cpu(child.pid)
        for number in range(count):
            share = marks.get(number)
            if share in _JUMPS:
                feeder.until_acknowledged()
                time.sleep(2.0)
                feeder.jump_back()
            elif share == _RETURN:
                feeder.come_back()
            elif share is not None:
                hard = resource.prlimit(child.pid, resource.RLIMIT_FSIZE)[1]
                room = 1 << 10 if share == _FULL[0] else hard
                resource.prlimit(child.pid, resource.RLIMIT_FSIZE, (room, hard))
            tenth = tenths[10 * number // count]
            tenth.messages += feeder.chunk(CHUNK / speed)
            now = _cpu(child.pid)
            tenth.cpu, before = tenth.cpu + now - before, now
            tenth.resident = max(tenth.resident, _resident(child.pid))
            progress.update(number + 1)
            require(child.poll() is None, f"the node ended with exit code {child.returncode}")
        feeder.until_acknowledged()
        child.send_signal(signal.SIGINT)
        require(child.wait(_PATIENCE) == 0, f"exit code {child.returncode}")
        _check(folder / "output", feeder.fed)
    except Failure as failure:
        said = (folder / "log").read_text(encoding="utf-8", errors="replace")
        raise Failure(f"{failure}; the node said: {said[-1500:]}") from failure
    finally:
        child.kill()
        child.wait()
        rclpy.shutdown()
    return tenths


def _check(output: Path, fed: Sequence[int]) -> None:
    """All that was published is in the accounts of one run or another, and each run has its rows.

    The first messages after a jump are the last ones of the run before, which tell it.
    """
    runs = sorted(output.glob("run_*"))
    require(len(runs) == len(_JUMPS), f"{len(runs)} copies for {len(_JUMPS)} jumps")
    received = [0, 0]
    for folder in (*runs, output):
        summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
        check_accounts(summary)
        received = [a + summary[t]["received"] for a, t in zip(received, TOPICS, strict=True)]
        with (folder / "poses.csv").open(encoding="utf-8") as file:
            rows = sum(1 for _ in file) - 1
        evaluated = summary["estimate"]["evaluated"]
        require(rows == evaluated, f"{folder.name}: {rows} rows, {evaluated} evaluated")
    require(received == list(fed), f"received {received} of {fed}")
    left = [path.name for path in output.glob(".*")]
    require(not left, f"left behind: {left}")


def main(argv: Sequence[str] | None = None) -> int:
    """Run, print a table; return 0, or 1 where something grew or was lost."""
    parser = argparse.ArgumentParser(prog="python -m fuzz.dds", description=__doc__)
    parser.add_argument("--minutes", type=float, default=8.0)
    parser.add_argument("--speed", type=float, default=40.0, help="seconds of stamps a second")
    arguments = parser.parse_args(argv)
    with tempfile.TemporaryDirectory(prefix="soak-") as name, own_domain() as domain:
        try:
            tenths = run(arguments.minutes, arguments.speed, Path(name), domain)
        except Failure as failure:
            print(f"failed: {failure}")
            return 1
    wrong = judge(tenths, _EARLY)
    hours = arguments.minutes * arguments.speed / 60.0
    if hours < _HOURS:
        print(f"memory is not judged: in {hours:.1f} h of stamps what is kept is not full yet")
        wrong = [line for line in wrong if "memory" not in line]
    print("\n".join([table(tenths), *wrong]))
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
