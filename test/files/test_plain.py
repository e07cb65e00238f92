# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Plain tables: block by block they are read as any other."""

import decimal
import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trajeval_ros.files import plain, text
from trajeval_ros.files.plain import as_digits, head_of, read_plain, scaled
from trajeval_ros.files.stamps import NANOSECONDS, SECONDS, read_stamps
from trajeval_ros.files.text import Layout, read_table
from trajeval_ros.files.trajectory import TrajectoryFileError

TWO = Layout({2: "stamp x"})

_DIGITS = st.text("0123456789", min_size=1, max_size=25)
_WRITTEN = st.builds(
    "".join,
    st.tuples(
        st.sampled_from(["", "-", "+"]),
        st.one_of(
            _DIGITS,
            st.tuples(_DIGITS, _DIGITS).map(".".join),
            _DIGITS.map("{}.".format),
            _DIGITS.map(".{}".format),
        ),
        st.one_of(st.just(""), st.integers(-400, 400).map("e{}".format), st.just("E+07")),
    ),
)
_NUMBERS = st.one_of(
    _WRITTEN,
    st.floats().map(repr),
    st.floats(-1e3, 1e3).map("{:.7f}".format),
    st.integers(0, 2**63).map("{:d}".format),
    st.sampled_from(["nan", "-NaN", "inf", "+Infinity", "-0.0", "1e999", "1e-999", "4.9e-324"]),
)
_NONE = [
    "",
    ".",
    "-",
    "1e",
    "1e+",
    "0x10",
    "1_0",
    "--1",
    "1.2.3",
    "nan(1)",
    "infin",
    "é",
    "1\r2",
    "\v",
]
_GAPS = st.sampled_from([" ", ",", "\t", ", ", "  "])
_ENDS = st.sampled_from(["\n", "\r\n", " \n", "# a b\n", "\n\n", "\n# c\n \n"])


@given(st.lists(st.tuples(_NUMBERS, _GAPS, _NUMBERS, _ENDS), min_size=1, max_size=6))
def test_a_plain_table_is_read_as_any_other(tmp_path_factory, rows):
    path = tmp_path_factory.mktemp("plain") / "table.txt"
    path.write_bytes(("# begins\n" + "".join(map("".join, rows))).encode())
    found = read_table(path, TWO)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(text, "_plain_table", lambda source, layout: None)
        expected = read_table(path, TWO)
    assert np.array_equal(found.values, expected.values, equal_nan=True)
    assert np.array_equal(found.rows, expected.rows)
    assert [*found.first] == [*expected.first]
    assert (found.named, found.remarks) == (expected.named, expected.remarks)
    for unit in (SECONDS, 6, NANOSECONDS):
        assert stamps_of(found, unit) == stamps_of(expected, unit)


def stamps_of(table, unit):
    """Its stamps, or why it has none."""
    try:
        stamps, finite, remarks = read_stamps(table, unit)
    except TrajectoryFileError as error:
        return str(error)
    return stamps.tolist(), finite.tolist(), remarks


@pytest.mark.parametrize("word", _NONE)
def test_what_is_no_number_is_refused_in_the_same_words(tmp_path, word):
    path = tmp_path / "table.txt"
    for line in (f"{word} 1\n", f"1 {word}\n", f"1 1 {word}\n"):
        path.write_bytes(f"1 1\n{line}".encode())
        assert refusal(path) == refusal(path, plainly=False)


def refusal(path, *, plainly=True):
    """What is said of a table, if it is refused."""
    with pytest.MonkeyPatch.context() as patch:
        if not plainly:
            patch.setattr(text, "_plain_table", lambda source, layout: None)
        try:
            return read_table(path, TWO).values.tolist()
        except TrajectoryFileError as error:
            return str(error)


@given(st.lists(_NUMBERS, min_size=1, max_size=8), st.sampled_from([0, 6, 9]))
def test_digits_are_scaled_as_decimal_arithmetic_does(words, exponent):
    digits, decimals, plain = as_digits(words)
    found, known = scaled(digits, decimals, exponent)
    for word, number, is_known, is_plain in zip(words, found, known, plain, strict=True):
        value = decimal.Decimal(word)
        letters = word.replace(".", "")
        assert is_plain == (set(word) <= set("0123456789.") and fits(letters))
        if is_plain and is_known:
            whole = value.scaleb(exponent).to_integral_value(decimal.ROUND_HALF_EVEN)
            assert number == whole


@given(st.lists(_NUMBERS, min_size=1, max_size=8), st.sampled_from([" ", "\t", " \t "]))
def test_digits_of_lines_are_those_of_their_first_words(words, blank):
    lines = [f"{word}{blank}1.5 2" for word in words]
    for of_lines, of_words in zip(as_digits(lines), as_digits(words), strict=True):
        assert of_lines.tolist() == of_words.tolist()


@pytest.mark.parametrize("word", ["1\x002", "1\x0b2", "1\x1f", "1.2.3", "12,3"])
def test_what_is_no_number_has_no_digits(word):
    # NumPy's strings end with their last letter that is not zero.
    assert not as_digits([word + "5"])[2][0]


def fits(figures):
    """Whether 64 bits hold them, of which nobody writes more than nineteen."""
    return len(figures) <= 19 and int(figures) < 2**63


@pytest.mark.parametrize("whole", [False, True], ids=["cut", "whole"])
def test_blocks_are_joined(tmp_path, monkeypatch, whole):
    monkeypatch.setattr(plain, "_BLOCK", 64)
    path = tmp_path / "table.txt"
    rows = [f"{row}.5 {row * row}\n" + "# comment\n" * (row % 3) for row in range(200)]
    path.write_text("".join(rows)[: None if whole else -1])
    found = read_plain(str(path), 2)
    if not whole:
        assert found is None
        return
    assert np.array_equal(found.values, [[row + 0.5, row * row] for row in range(200)])
    lines = path.read_text().splitlines()
    assert [float(lines[row - 1].split()[0]) for row in found.rows] == [*found.values[:, 0]]
    assert found.first.scaled(0)[1].tolist() == [False] * 200
    assert found.first.scaled(1)[0].tolist() == [10 * row + 5 for row in range(200)]


def test_a_line_without_an_end_is_not_plain(tmp_path, monkeypatch):
    monkeypatch.setattr(plain, "_BLOCK", 64)
    path = tmp_path / "table.txt"
    path.write_text("0.0 1\n" + 300 * "1")
    assert head_of(str(path)) == ["0.0 1"]
    assert read_plain(str(path), 2) is None


def test_a_long_file_takes_little_more_than_its_numbers(tmp_path, monkeypatch):
    monkeypatch.setattr(plain, "_BLOCK", 1 << 14)
    path = tmp_path / "table.txt"
    path.write_text("".join(f"{row}.{row:09d} {row * 1e-7:.7f}\n" for row in range(20_000)))
    tracemalloc.start()
    try:
        table = read_plain(str(path), 2)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    kept = 5 * 8 * len(table.rows)
    assert peak < 1.25 * kept + (1 << 18)


def test_stamps_beyond_any_double_are_refused_without_a_warning(tmp_path):
    path = tmp_path / "table.txt"
    path.write_text("1e308 0\n" * 2)
    with pytest.raises(TrajectoryFileError, match="row 1: the stamp '1e308' is out of the range"):
        read_stamps(read_table(path, TWO), SECONDS)


def test_the_least_of_64_bits_is_out_of_range_as_any_other(tmp_path):
    path = tmp_path / "table.txt"
    path.write_text("-9223372036854775808 0\n" * 2)
    with pytest.raises(TrajectoryFileError, match="is out of the range of seconds"):
        read_stamps(read_table(path, TWO), SECONDS)
