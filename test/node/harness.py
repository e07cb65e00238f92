# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Real processes over DDS: the node under test, publishers, and a subscriber that waits."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from node.data import SECOND, START, merged, messages, run
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import Trigger

from trajeval_ros.online.samples import PoseSamples

HERE = Path(__file__).parent
ROOT = HERE.parent.parent
PATIENCE = 120.0
"""How long a condition may take, s. Reached only when a test fails."""
MAX_WAIT = 30.0
"""The nodes' max_wait, s, unless a test asks for another. What a burst has no room for in shared
memory is sent again 3 s later: by then the usual second has passed, and poses are given up that
are evaluated on a machine with nothing else to do."""


class TimedOutError(AssertionError):
    """A condition did not come about."""


def environment(domain: int) -> dict[str, str]:
    """Return the environment of every process of a test: this machine only, its own domain."""
    return {
        **os.environ,
        "ROS_DOMAIN_ID": str(domain),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_PYTHON_CHECK_FIELDS": "1",
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
        "PYTHONPATH": os.pathsep.join(
            # Last, what is there: a ROS machine's packages, message packages made by hand.
            [
                *map(str, (ROOT, ROOT / "test", HERE)),
                *filter(None, [os.environ.get("PYTHONPATH")]),
            ]
        ),
        "RCUTILS_COLORIZED_OUTPUT": "0",
    }


class Process:
    """A child that prints into a file and never outlives the test."""

    def __init__(self, command: Sequence[str], domain: int, log: Path) -> None:
        self.log = log
        with log.open("wb") as output:
            self.child = subprocess.Popen(
                [sys.executable, *command],
                env=environment(domain),
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )

    @property
    def output(self) -> str:
        return self.log.read_text(encoding="utf-8", errors="replace")

    def send(self, number: signal.Signals) -> None:
        self.child.send_signal(number)

    def wait(self) -> int:
        try:
            return self.child.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            raise TimedOutError(f"the process goes on:\n{self.output}") from None

    def end(self, number: signal.Signals = signal.SIGINT) -> int:
        """Send a signal and return the exit code."""
        self.send(number)
        return self.wait()

    def kill(self) -> None:
        if self.child.poll() is None:
            self.child.kill()
        self.child.wait()


class Graph:
    """The test's own node beside the processes it starts."""

    def __init__(self, domain: int, folder: Path) -> None:
        self.domain = domain
        self.folder = folder
        self._processes: list[Process] = []
        self.context = Context()
        rclpy.init(
            args=[],
            context=self.context,
            domain_id=domain,
            signal_handler_options=SignalHandlerOptions.NO,
        )
        self.node = rclpy.create_node("test", context=self.context)
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)
        self.received: dict[str, list[Any]] = defaultdict(list)
        self.listen(DiagnosticArray, "/diagnostics")
        self._are_known = True  # the listeners, to the node

    def close(self) -> None:
        for process in self._processes:
            process.kill()
        self._executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()

    # ------------------------------------------------------------------------------- processes

    def start(self, *command: str) -> Process:
        process = Process(command, self.domain, self.folder / f"process_{len(self._processes)}.log")
        self._processes.append(process)
        return process

    def start_evaluator(self, *ros_arguments: str, **parameters: object) -> Process:
        """Start the node; a parameter's dots are written as double underscores."""
        arguments = ["-p", f"max_wait:={MAX_WAIT}", *ros_arguments]
        for name, value in parameters.items():
            text = json.dumps(value) if not isinstance(value, str) else value
            arguments += ["-p", f"{name.replace('__', '.')}:={text}"]
        return self.start("-m", "trajeval_ros.node.main", "--ros-args", *arguments)

    # ------------------------------------------------------------------------------- listening

    def listen(self, kind: type, topic: str, *, latched: bool = False) -> list[Any]:
        """Return the list that the messages of a topic go to."""
        heard = self.received[topic]
        self._are_known = False
        durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
        quality = QoSProfile(depth=10_000, durability=durability)
        self.node.create_subscription(kind, topic, heard.append, quality)
        return heard

    def until_known(self, prefix: str = "evaluator") -> None:
        """Wait until the node knows of all that is listened to here.

        That a listener knows of the node, and the graph of both, proves nothing: what the node
        publishes before it knows of the listener is lost. But a participant tells of its readers
        in the order in which they were made (DDSI-RTPS's discovery is reliable and in order): when
        the one that was made last is served, all others are.
        """
        heard: list[Any] = []
        last = self.node.create_subscription(
            DiagnosticArray, "/diagnostics", heard.append, QoSProfile(depth=100)
        )
        ours = f"{prefix}: "
        self.until(
            lambda: any(s.name.startswith(ours) for message in heard for s in message.status),
            "the node's health at the last listener",
        )
        self.node.destroy_subscription(last)
        self._are_known = True

    def spin(self, seconds: float = 0.02) -> None:
        self._executor.spin_once(timeout_sec=seconds)

    def until(self, condition: Callable[[], Any], what: str) -> Any:
        """Spin until the condition holds, and return what it returned."""
        deadline = time.monotonic() + PATIENCE
        while time.monotonic() < deadline:
            value = condition()
            if value:
                return value
            self.spin()
        logs = "\n".join(process.output for process in self._processes)
        health = "\n".join(f"{k}: {v.message}" for k, v in self.health().items())
        raise TimedOutError(f"waited in vain for: {what}\n{health}\n{logs}")

    def health(self, prefix: str = "evaluator") -> dict[str, Any]:
        """Return the statuses of the newest diagnostics by their short name."""
        for message in reversed(self.received["/diagnostics"]):
            ours = {
                status.name.removeprefix(f"{prefix}: "): status
                for status in message.status
                if status.name.startswith(f"{prefix}: ")
            }
            if ours:
                return ours
        return {}

    def until_health(self, name: str, words: str, level: int | None = None) -> Any:
        """Wait for diagnostics with ``words`` in the message of a status."""

        def said() -> Any:
            status = self.health().get(name)
            fits = status is not None and words in status.message
            return status if fits and (level is None or status.level == bytes([level])) else None

        return self.until(said, f"{name}: {words}")

    def until_accounted(self, topic: str, received: int) -> dict[str, str]:
        """Wait until the diagnostics have received this many; return the topic's values."""

        def there() -> dict[str, str] | None:
            values = self.account(topic)
            return values if int(values.get("received", -1)) >= received else None

        return self.until(there, f"{received} received on {topic}")

    def account(self, topic: str) -> dict[str, str]:
        """What the newest diagnostics say of a topic; nothing where they do not."""
        status = self.health().get(topic.replace("_", " "))
        return {} if status is None else values_of(status)

    # ------------------------------------------------------------------------------ publishing

    def publisher(
        self, topic: str, kind: type = PoseStamped, *, reliable: bool = True, latched: bool = False
    ) -> Any:
        quality = QoSProfile(
            depth=10_000,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        )
        return self.node.create_publisher(kind, topic, quality)

    def until_heard(self, *publishers: Any) -> None:
        """Wait until each publisher has a subscriber, and the node knows of all listeners here."""
        self.until(
            lambda: all(p.get_subscription_count() for p in publishers),
            "subscriptions to " + ", ".join(p.topic_name for p in publishers),
        )
        if not self._are_known:
            self.until_known()

    def rehearse(self, is_heard: Callable[[], Any], what: str, node: str = "/evaluator") -> None:
        """Publish a run of the past until all is heard that will be waited for, and start over.

        For listeners in other processes: whether the node knows of them can be seen neither in the
        graph nor by counting, and topics become known one by one. What has arrived proves it.
        ``is_heard`` asks for something of every topic, at every listener; the node has forgotten
        the rehearsal when this returns, and nothing that is published from then on is missed.
        """
        names = ("ground_truth", "estimate")
        publishers = [self.publisher(f"/{name}") for name in names]
        self.until_heard(*publishers)
        past = run(duration=2.0 * PATIENCE, start=START - 1000 * SECOND)
        streams = [messages(PoseStamped, samples) for samples in past]
        coming = iter(merged(streams))
        published = [0, 0]

        def heard() -> Any:
            # A few at a time: a burst may find no room, and then it comes 3 s later.
            for _, i, k in islice(coming, 12):
                publishers[i].publish(streams[i][k])
                published[i] += 1
            return is_heard()

        self.until(heard, f"{what}, at the rehearsal")
        for name, count in zip(names, published, strict=True):
            self.until_accounted(name, count)
        for publisher in publishers:
            self.node.destroy_publisher(publisher)
        self.call(f"{node}/reset")
        for name in names:
            self.until(partial(self._has_forgotten, name), f"{name}: another run")

    def _has_forgotten(self, topic: str) -> bool:
        return self.account(topic).get("received") == "0"

    def call(self, service: str) -> Trigger.Response:
        client = self.node.create_client(Trigger, service)
        self.until(client.service_is_ready, service)
        answer = self.answer(client, Trigger.Request(), service)
        self.node.destroy_client(client)
        return answer

    def answer(self, client: Any, request: Any, service: str) -> Any:
        """Ask, and ask again: an answer is lost while the client is not known to the server yet."""
        futures: list[Any] = []

        def answered() -> Any:
            if not futures or time.monotonic() > asked + PATIENCE / 4:
                ask()
            return next((future for future in futures if future.done()), None)

        def ask() -> None:
            nonlocal asked
            asked = time.monotonic()
            futures.append(client.call_async(request))

        asked = 0.0
        return self.until(answered, f"an answer of {service}").result()

    def set_parameter(self, name: str, value: Any, node: str = "/evaluator") -> Any:
        """Set a parameter of the node from outside; return SetParametersResult."""
        return self.set_parameters({name: value}, node)

    def set_parameters(self, values: dict[str, Any], node: str = "/evaluator") -> Any:
        """Set parameters all or none; return SetParametersResult."""
        from rcl_interfaces.srv import SetParametersAtomically
        from rclpy.parameter import Parameter

        client = self.node.create_client(
            SetParametersAtomically, f"{node}/set_parameters_atomically"
        )
        self.until(client.service_is_ready, client.srv_name)
        messages = [
            Parameter(name, value=value).to_parameter_msg() for name, value in values.items()
        ]
        request = SetParametersAtomically.Request(parameters=messages)
        answer = self.answer(client, request, "set_parameters")
        self.node.destroy_client(client)
        return answer.result


def values_of(status: Any) -> dict[str, str]:
    """Return a status's values by key."""
    return {value.key: value.value for value in status.values}


def accounted(account: dict[str, Any], used: str) -> bool:
    """Whether received = used + pending + rejected, in summary.json."""
    rest = account.get("pending", 0) + sum(account["rejected"].values())
    return bool(account["received"] == account[used] + rest)


def save_samples(path: Path, samples: PoseSamples) -> None:
    """Write samples for the player process."""
    import numpy as np

    np.savez(
        path,
        stamps=samples.stamps,
        positions=samples.positions,
        quaternions=samples.quaternions,
    )
