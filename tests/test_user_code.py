"""Failures of a user's code are errors in a line, with the place in the user's file."""

from __future__ import annotations

import signal
import sys
import time

import numpy as np
import pytest

from shared.errors import ConfigError
from shared.user_code import Attribute, Members, Method, UserCode, array_fault, kind_fault

CODE = UserCode("plant mine.py:Mine", __file__, "docs/own-controller.md")


class Mine:
    """An object of a user's, with a method for every failure."""

    label = "mine"

    def works(self, number):
        return number

    def divides(self):
        return 1 / 0

    def leaves(self):
        sys.exit("bye")

    def says_much(self):
        raise ValueError("x" * 1000 + "\nand more")

    def is_refused(self):
        raise ConfigError("walk.steps: expected fewer")

    def waits(self):
        time.sleep(60.0)

    def spins(self):
        while True:
            pass

    def other(self):
        return Mine()

    def itself(self):
        return self


def line(error) -> str:
    (text,) = str(error.value).splitlines()
    assert len(text) < 400
    return text


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("divides", "expected no error from divides, got ZeroDivisionError: division by zero at l"),
        ("leaves", "expected no error from leaves, got SystemExit: bye at line"),
        ("says_much", "got ValueError: xxxx"),
    ],
)
def test_an_error_is_named_with_its_line(name, expected):
    with pytest.raises(ConfigError) as error:
        CODE.call(name, getattr(Mine(), name))
    assert line(error).startswith("plant mine.py:Mine: expected")
    assert expected in line(error)
    assert line(error).endswith("of test_user_code.py; see docs/own-controller.md")


def test_an_error_in_a_line_is_passed_on():
    with pytest.raises(ConfigError, match=r"^walk\.steps: expected fewer$"):
        CODE.call("is_refused", Mine().is_refused)


@pytest.mark.parametrize("name", ["waits", "spins"])
def test_a_call_without_an_end_is_ended(name):
    with pytest.raises(ConfigError, match=f"expected {name} to return within 0.05 s") as error:
        CODE.call(name, getattr(Mine(), name), seconds=0.05)
    assert "at line" in line(error)
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)


def test_the_limit_of_an_outer_call_comes_back_after_an_inner_one():
    def outer():
        CODE.call("works", Mine().works, 1)
        return signal.getitimer(signal.ITIMER_REAL)[0]

    assert 40.0 < CODE.call("outer", outer, seconds=50.0) <= 50.0


def test_methods_of_a_guarded_object_are_checked_at_every_call():
    members: Members = {
        "label": Attribute(lambda value: kind_fault(value, str)),
        "works": Method(1, fault=lambda result, number: kind_fault(result, int)),
        "other": Method(same_kind=True),
        "itself": Method(same_kind=True),
    }
    mine = CODE.guard(Mine(), members)
    assert mine.works(1) == 1
    assert mine.itself() is mine
    for guarded in (mine, mine.other()):
        with pytest.raises(ConfigError, match="works: expected an int, got a str"):
            guarded.works("1")


@pytest.mark.parametrize(
    ("members", "expected"),
    [
        ({"absent": Method()}, "expected absent, got a Mine without it"),
        ({"works": Method()}, r"expected works\(\), got works\(number\): missing a required"),
        ({"divides": Method(2)}, r"expected divides\(…, …\), got divides\(\)"),
        ({"label": Attribute(lambda value: kind_fault(value, int))}, "label: expected an int"),
    ],
)
def test_an_object_without_the_members_is_refused(members, expected):
    with pytest.raises(ConfigError, match=expected) as error:
        CODE.guard(Mine(), members)
    line(error)


def test_an_object_that_cannot_be_guarded_is_refused():
    class Slotted:
        __slots__ = ()

        def works(self, number):
            return number

    with pytest.raises(ConfigError, match="expected a class without __slots__, got Slotted"):
        CODE.guard(Slotted(), {"works": Method(1)})


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (np.zeros(3), ""),
        (None, "expected tau as a float array of shape (3,), got None"),
        ([0.0, 0.0, 0.0], "expected tau as a float array of shape (3,), got a list"),
        (np.zeros(2), "expected tau as a float array of shape (3,), got (2,)"),
        (np.zeros(3, dtype=int), "got an array of int64"),
        (np.array([0.0, np.nan, np.inf]), "with finite numbers, got nan at [1]"),
    ],
)
def test_an_array_has_its_shape_and_finite_numbers(value, expected):
    fault = array_fault(value, (3,), "tau")
    assert fault == expected if not expected else expected in fault
