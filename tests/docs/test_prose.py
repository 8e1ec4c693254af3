"""The checker of words finds what the rules of CONTRIBUTING.md forbid, and nothing else."""

from __future__ import annotations

import pytest

from tests.prose import MAX_WORDS, Text, findings


def advice(words: str, *, docstring: bool = False) -> list[str]:
    return [each.advice for each in findings(Text("page.md", 1, words, docstring))]


@pytest.mark.parametrize(
    ("words", "found"),
    [
        ("What a node needs.", "begin with a verb or a noun"),
        ("Whether a robot has fallen.", "begin with a verb or a noun"),
        ("Of every service.", "begin with a verb or a noun"),
    ],
)
def test_a_docstring_begins_with_a_verb_or_a_noun(words: str, found: str) -> None:
    assert advice(words, docstring=True) == [found]
    assert advice(words) == []


@pytest.mark.parametrize(
    "words",
    ["Send it to whoever listens.", "It says what is sent.", "A message of ours.", "So many rows."],
)
def test_a_clause_that_stands_for_a_name_is_found(words: str) -> None:
    assert len(advice(words)) == 1


@pytest.mark.parametrize("words", ["the colour of the centre", "`what is sent` is a name", "a = b"])
def test_plain_words_and_code_pass(words: str) -> None:
    assert advice(words, docstring=True) == []


def test_a_long_sentence_is_found_by_its_words() -> None:
    assert advice("word " * MAX_WORDS + "end.") == [f"{MAX_WORDS + 1} words: make two sentences"]
    assert advice("word " * (MAX_WORDS - 1) + "end. Another.") == []
