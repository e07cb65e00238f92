# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The table of parameters: what is taken, what is refused, and in which words."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from twins.runs import balance, handed_over, simulated

from trajeval_ros.online.engine import Engine
from trajeval_ros.online.parameters import PARAMETERS, ParameterError, complete

NAMES = sorted(PARAMETERS)
NUMBERS = [n for n in NAMES if type(PARAMETERS[n].default) in (int, float)]
CHOICES = [n for n in NAMES if PARAMETERS[n].choices]
DYNAMIC = [n for n in NAMES if PARAMETERS[n].dynamic]

WRONG_TYPES = {
    bool: [0, 1, "true", 1.0, None, [True]],
    str: [0, None, True, 1.5, ["auto"]],
    float: ["1.0", None, True, [1.0]],
    int: [1.0, "8", None, True, [8]],
    tuple: ["0 0 0 0 0 0 1", None, 1.0, ["0"] * 7, [True] * 7, {}],
}


def refused(name, value, *words):
    """Each way in refuses, naming the parameter in one line."""
    for attempt in (lambda: Engine({name: value}), lambda: complete({name: value})):
        with pytest.raises(ParameterError) as caught:
            attempt()
        text = str(caught.value)
        assert name in text
        assert "\n" not in text
        for word in words:
            assert word in text


def test_without_values_every_parameter_has_its_default():
    assert complete({}) == {name: PARAMETERS[name].default for name in PARAMETERS}
    assert dict(Engine({}).parameters) == complete({})


@pytest.mark.parametrize("name", NAMES)
def test_a_default_is_taken_and_described(name):
    parameter = PARAMETERS[name]
    assert parameter.name == name
    assert parameter.description
    assert complete({name: parameter.default})[name] == parameter.default
    assert parameter.validate(parameter.default) == parameter.default


@pytest.mark.parametrize("name", NAMES)
def test_a_wrong_type_is_refused(name):
    for value in WRONG_TYPES[type(PARAMETERS[name].default)]:
        refused(name, value, "must be")


@pytest.mark.parametrize("name", NUMBERS)
def test_a_number_out_of_range_is_refused(name):
    parameter = PARAMETERS[name]
    kind = type(parameter.default)
    step = 1 if kind is int else 1e-9
    bounds = [(parameter.lower, -step), (parameter.upper, step)]
    for bound, outwards in bounds:
        if bound is None:
            continue
        assert parameter.validate(kind(bound)) == bound
        wrong = kind(bound + outwards * max(1, abs(bound)))
        assert wrong != bound
        refused(name, wrong, repr(wrong))
    for value in (math.nan, math.inf, -math.inf):
        refused(name, value)
    # Every number has an end on both sides, so that none overflows.
    assert parameter.lower is not None
    assert parameter.upper is not None


@pytest.mark.parametrize("name", CHOICES)
def test_a_word_that_is_no_choice_is_refused(name):
    for choice in PARAMETERS[name].choices:
        # Transforms are named.
        more = {name.replace("type", "topic"): "/tf:a.b"} if choice == "TFMessage" else {}
        assert complete({name: choice, **more})[name] == choice
    for wrong in ("", "AUTO", PARAMETERS[name].default + " "):
        refused(name, wrong, *PARAMETERS[name].choices)


@pytest.mark.parametrize(
    "value",
    [
        [0.0] * 6,
        [0.0] * 7,
        [0, 0, 0, 0, 0, 0, 1, 0],
        [],
        [math.nan, 0, 0, 0, 0, 0, 1],
        [0, 0, math.inf, 0, 0, 0, 1],
        [0, 0, 0, 0, 0, 0, 1.1],
        [0, 0, 0, 1, 1, 0, 0],
    ],
)
def test_an_extrinsic_that_is_no_pose_is_refused(value):
    refused("extrinsic", value)


@pytest.mark.parametrize(
    "value", [[1, 2, 3, 0, 0, 0, 1], (1.0, 2.0, 3.0, 0.0, 0.0, 0.0, -1.0), np.eye(7)[6].tolist()]
)
def test_an_extrinsic_is_taken_from_any_list_of_numbers(value):
    assert complete({"extrinsic": value})["extrinsic"] == tuple(map(float, value))


def test_whole_numbers_do_for_fractions():
    values = complete({"max_wait": 2})
    assert values["max_wait"] == 2.0
    assert type(values["max_wait"]) is float


@pytest.mark.parametrize("name", ["", "gp", "Gauge", "max_wait ", "ground_truth.lagg"])
def test_an_unknown_name_is_refused(name):
    with pytest.raises(ParameterError, match="unknown parameter"):
        Engine({name: 1.0})
    with pytest.raises(ParameterError, match="unknown parameter"):
        Engine({}).set(name, 1.0)


def test_sizes_that_exclude_each_other_are_refused():
    with pytest.raises(ParameterError, match=r"segment.min_samples"):
        Engine({"segment.min_samples": 100, "segment.max_samples": 50})


@pytest.mark.parametrize("name", [n for n in NAMES if not PARAMETERS[n].dynamic])
def test_what_is_read_only_cannot_be_set(name):
    engine = Engine({})
    with pytest.raises(ParameterError, match="read-only"):
        engine.set(name, PARAMETERS[name].default)
    assert dict(engine.parameters) == complete({})


@pytest.mark.parametrize("name", DYNAMIC)
def test_what_is_dynamic_is_checked_when_set(name):
    engine = Engine({})
    engine.set(name, PARAMETERS[name].default)
    for value in WRONG_TYPES[type(PARAMETERS[name].default)]:
        with pytest.raises(ParameterError, match=name):
            engine.set(name, value)
    if name in NUMBERS:
        for value in (-1.0, 1e9, math.nan):
            with pytest.raises(ParameterError, match=name):
                engine.set(name, value)
    assert dict(engine.parameters) == complete({})


def test_the_parameters_handed_out_are_a_copy():
    engine = Engine({})
    dict.update(engine.parameters, {"gauge": "none"})
    assert engine.parameters["gauge"] == "se3"


def test_a_reset_keeps_what_was_set():
    engine = Engine({})
    engine.set("window.duration", 5.0)
    engine.reset()
    assert engine.parameters["window.duration"] == 5.0


def extremes():
    """Values at the ends of their ranges, of the parameters that shape the computation."""
    names = [n for n in NUMBERS if n not in ("estimate.time_offset",)]
    pairs = []
    for name in names:
        parameter = PARAMETERS[name]
        for bound in (parameter.lower, parameter.upper):
            if bound is not None:
                pairs.append((name, type(parameter.default)(bound)))
    return pairs


@given(pairs=st.lists(st.sampled_from(extremes()), min_size=1, max_size=2))
@settings(max_examples=25)
def test_the_ends_of_the_ranges_can_be_lived_with(pairs):
    values = {"gp.hyperparameters": "fixed", **dict(pairs)}
    try:
        complete(values)
    except ParameterError:
        return  # they exclude each other
    run = simulated(51, 5.0, rates=(30.0, 8.0), dropouts=((2.0, 3.0),))
    engine, found = handed_over(values, run)
    assert balance(engine).pending == 0
    assert np.isfinite(found["chi2"]).all()
    assert np.isfinite(found["covariance"]).all()


def test_a_noise_that_the_arithmetic_cannot_hold_is_refused():
    fixed = {"gp.hyperparameters": "fixed", "gp.translation.signal_std": 100.0}
    with pytest.raises(ParameterError, match=r"gp\.translation\.noise_std must be at least 1e-06"):
        complete({**fixed, "gp.translation.noise_std": 1e-9})


OTHER = (0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)


@pytest.mark.parametrize("names", [("estimate",), ("vins",)])
def test_one_estimate_has_two_names_for_its_extrinsic(names):
    own = f"{names[0]}.extrinsic"
    for name in ("extrinsic", own):
        values = complete({name: OTHER}, names)
        assert values["extrinsic"] == values[own] == OTHER
        assert complete(values, names) == values
    with pytest.raises(ParameterError, match=f"extrinsic and {own} mean the same and differ"):
        complete({"extrinsic": OTHER, own: (0.2, *OTHER[1:])}, names)
    with pytest.raises(ParameterError, match="unknown parameter extrinsic"):
        complete({"extrinsic": OTHER}, ("vins", "orb"))


def test_the_names_are_those_that_are_given():
    assert complete({"estimates": ["vins", "orb"]}, ("vins", "orb"))["estimates"] == ("vins", "orb")
    with pytest.raises(ParameterError, match=r"estimates is \[a, b\], but the estimates are \[b"):
        complete({"estimates": ["a", "b"]}, ("b", "a"))
