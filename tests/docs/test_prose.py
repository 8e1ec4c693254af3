"""The checker of words finds what the rules of CONTRIBUTING.md forbid, and nothing else."""

from __future__ import annotations

from typing import Literal

import pytest

from tests.prose import MAX_WORDS, Text, _of_comments, findings


def advice(
    words: str, kind: Literal["docstring", "comment", "error", "other"] = "other"
) -> list[str]:
    return [each.advice for each in findings(Text("page.md", 1, words, kind))]


@pytest.mark.parametrize(
    ("words", "found"),
    [
        ("What a node needs.", "begin with a verb or a noun"),
        ("Whether a robot has fallen.", "begin with a verb or a noun"),
        ("Of every service.", "begin with a verb or a noun"),
    ],
)
def test_a_docstring_begins_with_a_verb_or_a_noun(words: str, found: str) -> None:
    assert advice(words, "docstring") == [found]
    assert advice(words) == []


@pytest.mark.parametrize(
    "words",
    ["Send it to whoever listens.", "It says what is sent.", "A message of ours.", "So many rows."],
)
def test_a_clause_that_stands_for_a_name_is_found(words: str) -> None:
    assert len(advice(words)) == 1


@pytest.mark.parametrize(
    "words",
    [
        "The foot in the air lands.",
        "The capture point.",
        "Until the robot's begin.",
        "The stall ends.",
    ],
)
def test_a_second_word_for_a_thing_of_the_glossary_is_found(words: str) -> None:
    assert len(advice(words)) == 1


def test_an_error_says_what_came() -> None:
    assert advice("seed: expected 0 or more; try 1", "error") == ["say what came: got …"]
    assert advice("seed: expected 0 or more, got …; try 1", "error") == []


def test_comments_of_successive_lines_are_one_text() -> None:
    source = "# What ns-3 calls\n# a size.\na = 1  # the size\n# noqa: E501\n"
    first, second = _of_comments("a.py", source)
    assert (first.words, first.line) == ("What ns-3 calls a size.", 1)
    assert second.words == "the size"
    assert advice(first.words, "comment") == ["begin with a verb or a noun"]
    assert advice("Whether it lands.", "comment") == []


@pytest.mark.parametrize("words", ["the colour of the centre", "`what is sent` is a name", "a = b"])
def test_plain_words_and_code_pass(words: str) -> None:
    assert advice(words, "docstring") == []


def test_a_long_sentence_is_found_by_its_words() -> None:
    assert advice("word " * MAX_WORDS + "end.") == [f"{MAX_WORDS + 1} words: make two sentences"]
    assert advice("word " * (MAX_WORDS - 1) + "end. Another.") == []
