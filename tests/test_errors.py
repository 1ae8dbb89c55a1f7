"""The checks of what callers give."""

import math
from fractions import Fraction

import numpy as np
import pytest

from collaborative_gym.errors import (
    UnknownName,
    check_count,
    check_flag,
    check_number,
    check_numbers,
    look_up,
    naming,
    shown,
    unknown,
)

NO_NUMBERS = [True, np.True_, "1", None, 1j, [1], np.ones(2), np.timedelta64(1, "s")]


def test_of_many_names_the_nearest_are_listed():
    told = unknown("door", "door77", [f"door {i}" for i in range(99)])
    assert "did you mean 'door 77'?); doors: " in told
    assert len(told) < 200 and "and 91 others" in told


@pytest.mark.parametrize("given", [3, np.int8(3), np.uint64(3)])
def test_a_count_becomes_pythons_integer(given):
    assert type(check_count("episodes", given, at_least=3, at_most=3)) is int


@pytest.mark.parametrize("given", [*NO_NUMBERS, 1.0, np.float32(1.0), math.nan])
def test_what_is_no_count(given):
    with pytest.raises(TypeError, match=r"^episodes must be an integer, got "):
        check_count("episodes", given)


def test_counts_have_bounds():
    with pytest.raises(ValueError, match=r"^episodes must be at least 1, got 0$"):
        check_count("episodes", 0, at_least=1)
    with pytest.raises(ValueError, match=r"^port must be at most 65535, got 65536$"):
        check_count("port", 65536, at_most=65535)
    with pytest.raises(
        ValueError, match=r"^episodes must be at most 9223372036854775807, got"
    ):
        check_count("episodes", 2**63)


@pytest.mark.parametrize("given", [2, 2.0, np.float32(2.0), np.int8(2), Fraction(4, 2)])
def test_a_number_becomes_a_float(given):
    number = check_number("mass", given, at_least=2.0, at_most=2)
    assert type(number) is float and number == 2.0


@pytest.mark.parametrize("given", NO_NUMBERS)
def test_what_is_no_number(given):
    with pytest.raises(TypeError, match=r"^mass must be a number, got "):
        check_number("mass", given)


@pytest.mark.parametrize("given", [math.nan, math.inf, -math.inf, 10**400])
def test_numbers_are_finite(given):
    with pytest.raises(ValueError, match=r"^mass must be finite, got "):
        check_number("mass", given)


def test_numbers_have_bounds():
    with pytest.raises(ValueError, match=r"^mass must be above 0, got 0$"):
        check_number("mass", 0, above=0)
    with pytest.raises(ValueError, match=r"^mass must be at least 0, got -1e-09$"):
        check_number("mass", -1e-9, at_least=0.0)
    with pytest.raises(ValueError, match=r"^mass must be 0.5 to 2, got 2.5$"):
        check_number("mass", 2.5, at_least=0.5, at_most=2.0)


def test_several_numbers():
    assert check_numbers("position", np.arange(3), 3) == (0.0, 1.0, 2.0)
    for given in ("123", 1.0, {1, 2, 3}, None):
        with pytest.raises(TypeError, match=r"^position must be 3 numbers, got "):
            check_numbers("position", given, 3)
    with pytest.raises(ValueError, match=r"^position must be 3 numbers, got \[1, 2\]$"):
        check_numbers("position", [1, 2], 3)
    with pytest.raises(TypeError, match=r"^position\[1\] must be a number, got '2'$"):
        check_numbers("position", [1, "2", 3], 3)


def test_flags_are_no_numbers():
    assert check_flag("web", np.True_) is True
    with pytest.raises(TypeError, match=r"^web must be True or False, got 1$"):
        check_flag("web", 1)


def test_names_are_looked_up():
    assert look_up("robot", "panda", {"panda": 3}) == 3
    with pytest.raises(
        KeyError, match=r"no robot 'pand' .did you mean 'panda'.*; robots"
    ):
        look_up("robot", "pand", {"panda": 3})
    for given in ([], None, 3):
        with pytest.raises(KeyError, match=r"no robot .*; robots: panda"):
            look_up("robot", given, {"panda": 3})


def test_what_is_shown_is_short():
    assert shown("a") == "'a'"
    assert len(shown(np.eye(30))) == 80 and "\n" not in shown(np.eye(30))


@pytest.mark.parametrize(
    "kind", [FileNotFoundError, UnknownName, TypeError, ValueError]
)
def test_errors_name_the_input(kind):
    with pytest.raises(kind) as caught, naming("player 'late'"):
        raise kind("it is damaged")
    assert type(caught.value) is kind
    assert str(caught.value) == "player 'late': it is damaged"


def test_errors_that_are_more_than_a_message_name_the_input():
    told = "player 'late': 'utf-8' codec"
    with pytest.raises(ValueError, match=told) as caught, naming("player 'late'"):
        b"\xff".decode()
    assert isinstance(caught.value.__cause__, UnicodeDecodeError)


def test_errors_that_are_not_about_the_input_stay():
    with pytest.raises(PermissionError, match=r"^no$"), naming("player 'late'"):
        raise PermissionError("no")
