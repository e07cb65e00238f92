# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The parameters: one table of names, defaults, ranges and texts.

The node declares them from here, ``evaluate`` reads them from here, and a test holds
``config/evaluator.yaml`` and ``docs/parameters.md`` to it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

from trajeval_ros.ground_truth.hyperparameters import FURTHER_COMPONENTS, LEAST_NOISE
from trajeval_ros.online.axes import AS_GIVEN, AXES

Value = str | bool | int | float | tuple[float, ...] | tuple[str, ...]


class ParameterError(ValueError):
    """A parameter that is unknown, of the wrong type or out of range; the message is one line."""


class Parameter(NamedTuple):
    """One parameter.

    ``lower`` and ``upper`` are inclusive. ``dynamic`` parameters may be changed while the node
    runs, the others are read-only.
    """

    name: str
    default: Value
    description: str
    unit: str = ""
    lower: float | None = None
    upper: float | None = None
    choices: tuple[str, ...] = ()
    dynamic: bool = False
    pattern: str = ""
    """What a string that is not empty must match as a whole."""
    is_open: bool = False
    """Whether a message type, ``package/msg/Type``, may be given instead of the choices."""

    def validate(self, value: object) -> Value:
        """Return ``value`` in the parameter's type; raises :class:`ParameterError`."""
        converted = self._convert(value)
        is_type = self.is_open and re.fullmatch(_TYPE, str(converted)) is not None
        if self.choices and converted not in self.choices and not is_type:
            instead = " or package/msg/Type" if self.is_open else ""
            raise ParameterError(
                f"{self.name} must be one of {', '.join(self.choices)}{instead}, got {converted!r}"
            )
        if self.pattern and converted and not re.fullmatch(self.pattern, str(converted)):
            raise ParameterError(f"{self.name}: {converted!r} is neither a topic nor a transform")
        if isinstance(converted, float | int) and not isinstance(converted, bool):
            self._check_range(float(converted))
        if isinstance(converted, tuple) and isinstance(self.default, tuple):
            if isinstance(self.default[0], float):
                self._check_pose(tuple(map(float, converted)))
            else:
                check_names(tuple(map(str, converted)))
        return converted

    def _convert(self, value: object) -> Value:
        number = isinstance(value, float | int) and not isinstance(value, bool)
        match self.default:
            case bool() if isinstance(value, bool):
                return value
            case str() if isinstance(value, str):
                return value
            case float() if number:
                return float(value)  # type: ignore[arg-type]
            case int() if isinstance(value, int) and not isinstance(self.default, bool) and number:
                return value
            case tuple(names) if not isinstance(value, str) and hasattr(value, "__iter__"):
                entries = list(value)
                if isinstance(names[0], str):
                    if all(isinstance(entry, str) for entry in entries):
                        return tuple(entries)
                elif all(isinstance(v, float | int) and not isinstance(v, bool) for v in entries):
                    return tuple(float(v) for v in entries)
        kinds = {bool: "a bool", str: "a string", float: "a number", int: "an integer"}
        words = isinstance(self.default, tuple) and isinstance(self.default[0], str)
        kind = kinds.get(type(self.default), f"a list of {'strings' if words else 'numbers'}")
        raise ParameterError(f"{self.name} must be {kind}, got {value!r}")

    def _check_range(self, value: float) -> None:
        if not math.isfinite(value):
            raise ParameterError(f"{self.name} must be finite, got {value!r}")
        if self.lower is not None and value < self.lower:
            raise ParameterError(f"{self.name} must be at least {self.lower!r}, got {value!r}")
        if self.upper is not None and value > self.upper:
            raise ParameterError(f"{self.name} must be at most {self.upper!r}, got {value!r}")

    def _check_pose(self, value: tuple[float, ...]) -> None:
        if len(value) != 7 or not all(map(math.isfinite, value)):
            raise ParameterError(
                f"{self.name} must be seven finite numbers x y z qx qy qz qw, got {list(value)!r}"
            )
        norm = math.hypot(*value[3:])
        if abs(norm - 1.0) > 1e-2:
            raise ParameterError(f"{self.name} has a quaternion of norm {norm:.6g}, expected 1")


IDENTITY = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)

MESSAGE_TYPES = (
    "PoseStamped",
    "PoseWithCovarianceStamped",
    "Odometry",
    "TransformStamped",
    "Path",
    "PointStamped",
    "NavSatFix",
)

TRANSFORM_TYPES = ("TFMessage", "tf2_msgs/msg/TFMessage")

_TYPE = r"[a-z][a-z0-9_]*/msg/[A-Z][A-Za-z0-9]*"
_TOPIC = r"~?/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*(:[^:.]+\.[^:]+)?"


def _topic(name: str, title: str) -> tuple[Parameter, ...]:
    return (
        Parameter(
            f"{name}.topic",
            "",
            f"Topic, or a transform as /tf:map.base_link; empty: {name}",
            pattern=_TOPIC,
        ),
        Parameter(
            f"{name}.type",
            "auto",
            "Message type, also any installed package/msg/Type; auto: its publishers'",
            choices=("auto", *MESSAGE_TYPES, "TFMessage"),
            is_open=True,
        ),
        Parameter(
            f"{name}.field",
            "pose",
            "Where the pose is in a package/msg/Type, as poses[name=drone].pose",
        ),
        Parameter(
            f"{name}.stamp_field",
            "header.stamp",
            "Where the stamp of a package/msg/Type is, a ROS time",
        ),
        Parameter(
            f"{name}.axes",
            AS_GIVEN,
            "World and body axes: ned_frd (as PX4) is turned to ROS's",
            choices=AXES,
        ),
        Parameter(
            f"{name}.reliability",
            "auto",
            "Reliability of the subscription; auto: its publishers'",
            choices=("auto", "reliable", "best_effort"),
        ),
        Parameter(
            f"{name}.use_covariance",
            False,
            f"Whether each {title} message's covariance counts",
        ),
    )


def _group(name: str, title: str, unit: str, noise: float) -> tuple[Parameter, ...]:
    return (
        Parameter(
            f"gp.{name}.signal_std",
            0.5,
            f"Signal standard deviation of {title}",
            unit,
            lower=1e-9,
            upper=1e6,
        ),
        Parameter(
            f"gp.{name}.length_scale", 1.0, f"Length scale of {title}", "s", lower=1e-6, upper=1e6
        ),
        *(
            parameter
            for part, text in FURTHER_COMPONENTS.items()
            for parameter in (
                Parameter(
                    f"gp.{name}.{part}_std",
                    0.0,
                    f"Standard deviation of the {text} in {title}, matern52; 0: none",
                    unit,
                    lower=0.0,
                    upper=1e6,
                ),
                Parameter(
                    f"gp.{name}.{part}_length_scale",
                    1.0,
                    f"Length scale of the {text} in {title}, matern52",
                    "s",
                    lower=1e-6,
                    upper=1e6,
                ),
            )
        ),
        Parameter(
            f"gp.{name}.noise_std",
            noise,
            f"Noise standard deviation of {title}",
            unit,
            lower=1e-9,
            upper=1e3,
        ),
    )


_TABLE = (
    Parameter(
        "estimates",
        ("estimate",),
        "The estimates: each name is an input topic, and has the parameters that estimate has here",
    ),
    *_topic("estimate", "estimate"),
    *_topic("ground_truth", "ground truth"),
    Parameter(
        "ground_truth.translation_std",
        0.0005,
        "Accuracy of the ground truth's position: the floor of its learned noise",
        "m",
        lower=1e-9,
        upper=1e3,
    ),
    Parameter(
        "ground_truth.rotation_std",
        0.00087,
        "Accuracy of the ground truth's orientation: the floor of its learned noise",
        "rad",
        lower=1e-9,
        upper=3.2,
    ),
    Parameter(
        "estimate.time_offset",
        0.0,
        "Added to the stamps of the estimate",
        "s",
        # What nanoseconds in 64 bits can hold, nearly.
        lower=-9e9,
        upper=9e9,
    ),
    Parameter(
        "estimate.extrinsic",
        IDENTITY,
        "The estimate's body frame in the ground truth's body frame, x y z qx qy qz qw",
        "m",
    ),
    Parameter(
        "extrinsic",
        IDENTITY,
        "The same as estimate.extrinsic, where there is one estimate",
        "m",
    ),
    Parameter(
        "ground_truth.lag",
        0.3,
        "Ground truth up to this long after an estimate is used for it",
        "s",
        lower=0.0,
        upper=60.0,
    ),
    Parameter(
        "ground_truth.max_gap",
        1.0,
        "Farther than this from any sample an estimate is not scored",
        "s",
        lower=1e-6,
        upper=3600.0,
    ),
    Parameter(
        "ground_truth.stamps",
        "measured",
        "measured: their noise is learned; regularize: the regular clock's behind late ones",
        choices=("measured", "exact", "regularize"),
    ),
    Parameter(
        "gp.kernel",
        "matern52",
        "Covariance function of the ground truth's motion",
        choices=("matern52", "matern32", "squared_exponential"),
    ),
    Parameter(
        "gp.hyperparameters",
        "auto",
        "auto: learned; fixed: those of gp.translation and gp.rotation",
        choices=("auto", "fixed"),
    ),
    *_group("translation", "the translation", "m", 0.001),
    *_group("rotation", "the rotation", "rad", 0.002),
    Parameter(
        "segment.duration", 2.0, "Shortest duration of a segment", "s", lower=1e-3, upper=3600.0
    ),
    Parameter(
        "segment.overlap", 0.5, "Share of a segment that overlaps the next", lower=0.1, upper=0.5
    ),
    Parameter(
        "segment.min_samples", 8, "Fewest samples in a complete segment", lower=4, upper=1024
    ),
    Parameter("segment.max_samples", 256, "Most samples in a segment", lower=16, upper=1024),
    Parameter(
        "window.duration",
        30.0,
        "Length of the sliding window",
        "s",
        lower=1.0,
        upper=3600.0,
        dynamic=True,
    ),
    Parameter(
        "likelihood.covariance",
        "independent",
        "Covariance of the ground truth at different estimates: none, or the posterior's",
        choices=("independent", "joint"),
    ),
    Parameter(
        "gauge",
        "se3",
        "What of the estimate's frame is unobservable and aligned",
        choices=("se3", "none", "yaw_translation", "sim3"),
    ),
    Parameter(
        "relative.delta",
        1.0,
        "Step of the conventional relative error",
        "s, m or f",
        lower=1e-3,
        upper=1e6,
    ),
    Parameter(
        "relative.unit",
        "s",
        "Unit of relative.delta: seconds, metres, or f, evaluated poses (frames)",
        choices=("s", "m", "f"),
    ),
    Parameter(
        "max_wait",
        1.0,
        "How long after an estimate its ground truth may still come, on the ROS clock",
        "s",
        lower=0.0,
        upper=3600.0,
        dynamic=True,
    ),
    Parameter(
        "output.directory",
        "",
        "Where the output folder is written at shutdown and by ~/save; nowhere when empty",
        dynamic=True,
    ),
)

PARAMETERS: Mapping[str, Parameter] = MappingProxyType({p.name: p for p in _TABLE})
"""The parameters of a run with one estimate, which is called ``estimate``."""

ONE = ("estimate",)
_NAME = re.compile(r"[a-z][a-z0-9_]*")
# Those of earlier runs in the output folder.
_RUN = re.compile(r"run_[0-9]+")
# What a parameter, a status or an output topic begins with already.
_TAKEN = {
    *("ground_truth", "comparison", "metrics", "markers", "reset", "save"),
    *("absolute", "conventional"),
    *(p.name.partition(".")[0] for p in _TABLE if not p.name.startswith("estimate.")),
}


def is_taken(name: str) -> bool:
    """Whether a name means something else than an estimate."""
    return name in _TAKEN or _RUN.fullmatch(name) is not None


def is_name(name: str) -> bool:
    """Whether an estimate can be called so."""
    return _NAME.fullmatch(name) is not None and not is_taken(name)


def check_names(names: Sequence[str]) -> tuple[str, ...]:
    """Return the names of a run's estimates.

    Raises
    ------
    ParameterError
        For none, one that comes twice, is not snake_case, or means something else already.
    """
    if not names:
        raise ParameterError("estimates must be at least one name")
    for name in names:
        if not _NAME.fullmatch(name):
            raise ParameterError(f"estimates must be named in snake_case, got {name!r}")
        if is_taken(name):
            raise ParameterError(f"an estimate cannot be named {name}: that means something else")
        if list(names).count(name) > 1:
            raise ParameterError(f"estimates must have different names, got {name} twice")
    return tuple(names)


def names_in(values: Mapping[str, object]) -> tuple[str, ...]:
    """Return the names of the estimates that ``estimates`` among the ``values`` says.

    Raises :class:`ParameterError` as :func:`check_names` does.
    """
    parameter = PARAMETERS["estimates"]
    names = parameter.validate(values.get("estimates", parameter.default))
    assert isinstance(names, tuple)
    return tuple(map(str, names))


def table(names: Sequence[str] = ONE) -> Mapping[str, Parameter]:
    """Return the parameters of a run with these estimates, by name.

    Those of ``estimate`` are there for each name; ``extrinsic`` only where there is one estimate.
    """
    if tuple(names) == ONE:
        return PARAMETERS
    found: dict[str, Parameter] = {}
    for parameter in _TABLE:
        if parameter.name.startswith("estimate."):
            rest = parameter.name.removeprefix("estimate.")
            found |= {p.name: p for p in (parameter._replace(name=f"{n}.{rest}") for n in names)}
        elif parameter.name != "extrinsic" or len(names) == 1:
            found[parameter.name] = parameter
    return found


# What a ROS parameter file may hold for any node.
_OF_ROS = ("use_sim_time", "start_type_description_service")
_PREFIX_OF_ROS = "qos_overrides."


def is_of_ros(name: str) -> bool:
    """Whether a parameter is ROS's own: the node has it, and the evaluation passes over it."""
    return name in _OF_ROS or name.startswith(_PREFIX_OF_ROS)


def of_estimate(values: Mapping[str, Value], name: str) -> dict[str, Value]:
    """Return the values for one of several estimates, under the names of a run with one."""
    found = dict(values)
    for known in PARAMETERS:
        if known.startswith("estimate."):
            found[known] = values[f"{name}.{known.removeprefix('estimate.')}"]
    return {**found, "estimates": ONE, "extrinsic": found["estimate.extrinsic"]}


def complete(values: Mapping[str, object], names: Sequence[str] = ONE) -> dict[str, Value]:
    """Return every parameter's value: ``values``, validated, over the defaults.

    ``names``: of the estimates.

    Raises
    ------
    ParameterError
        For an unknown name, a wrong type, a value out of range, or values that exclude each other.
    """
    parameters = table(check_names(names))
    unknown = sorted(set(values) - set(parameters))
    if unknown:
        why = "" if unknown[0] not in PARAMETERS else _each_its_own(unknown[0], names)
        raise ParameterError(f"unknown parameter {unknown[0]}{why}")
    merged = {
        name: parameter.validate(values[name]) if name in values else parameter.default
        for name, parameter in parameters.items()
    }
    if "estimates" in values and merged["estimates"] != tuple(names):
        raise ParameterError(
            f"estimates is {_listed(merged['estimates'])}, but the estimates are {_listed(names)}"
        )
    merged["estimates"] = tuple(names)
    if "extrinsic" in merged:
        _agree(merged, "extrinsic", f"{names[0]}.extrinsic")
    _check_fields(merged)
    _check_transforms(merged)
    if merged["segment.min_samples"] > merged["segment.max_samples"]:  # type: ignore[operator]
        raise ParameterError("segment.min_samples must not exceed segment.max_samples")
    delta = merged["relative.delta"]
    if merged["relative.unit"] == "f" and delta != int(delta):  # type: ignore[arg-type]
        raise ParameterError(f"relative.delta must be a whole number of frames, got {delta!r}")
    if merged["gp.hyperparameters"] == "fixed":
        for group in ("translation", "rotation"):
            for part in ("signal", *FURTHER_COMPONENTS):
                signal, noise = merged[f"gp.{group}.{part}_std"], merged[f"gp.{group}.noise_std"]
                if noise < LEAST_NOISE * signal:  # type: ignore[operator]
                    raise ParameterError(
                        f"gp.{group}.noise_std must be at least {LEAST_NOISE:g} of "
                        f"gp.{group}.{part}_std, got {noise!r} and {signal!r}"
                    )
    return merged


def _check_fields(values: Mapping[str, Value]) -> None:
    """Refuse a field that would be passed over."""
    for name, value in values.items():
        source, _, part = name.rpartition(".")
        if part not in ("field", "stamp_field") or "/" in str(values[f"{source}.type"]):
            continue
        if value != PARAMETERS[f"ground_truth.{part}"].default:
            raise ParameterError(f"{name} needs {source}.type to be a package/msg/Type")


def _check_transforms(values: Mapping[str, Value]) -> None:
    """Transforms are named, and nothing else is."""
    for name, value in values.items():
        source, _, part = name.rpartition(".")
        if part != "type":
            continue
        named = ":" in str(values[f"{source}.topic"])
        if value in TRANSFORM_TYPES and not named:
            raise ParameterError(
                f"{name} {value} is many transforms: name one, as in"
                f" {source}.topic: /tf:map.base_link"
            )
        if named and value not in ("auto", *TRANSFORM_TYPES):
            raise ParameterError(f"{source}.topic names a transform, but {name} is {value}")


def _agree(values: dict[str, Value], *pair: str) -> None:
    """Give two names of one parameter the value that is not the default, if either has one."""
    given = {values[name] for name in pair} - {IDENTITY}
    if len(given) > 1:
        raise ParameterError(f"{' and '.join(pair)} mean the same and differ: set one of them")
    if given:
        (value,) = given
        values |= dict.fromkeys(pair, value)


def _each_its_own(parameter: str, names: Sequence[str]) -> str:
    rest = parameter.removeprefix("estimate.")
    return f": the estimates are {', '.join(names)}, so set {names[0]}.{rest} and so on"


def _listed(names: object) -> str:
    return f"[{', '.join(names)}]" if isinstance(names, tuple | list) else repr(names)
