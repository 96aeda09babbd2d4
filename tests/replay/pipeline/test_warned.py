"""Warnings of a replay: each once, with a count."""

from __future__ import annotations

from groundtrace.pipeline.warned import warnings_of
from groundtrace_codecs.events import Note

NS = 10**9


def note(text: str, at_s: float = 1.0, source: str = "steps", level: str = "WARN") -> Note:
    return Note(round(at_s * NS), text, level, source)


def lines(*notes: Note) -> list[str]:
    return [warned.line for warned in warnings_of(notes, 0)]


def test_only_what_warns_is_told_in_the_order_in_which_it_came() -> None:
    found = warnings_of(
        [note("b", 3), note("quiet", level="INFO"), note("a", 5, level="ERROR")], NS
    )
    assert [(w.text, w.time_s, w.count) for w in found] == [("b", 2.0, 1), ("a", 4.0, 1)]


def test_what_is_said_again_is_told_once_with_a_count() -> None:
    assert lines(note("a"), note("a", 2), note("a", 3)) == ["a (3 times)"]


def test_the_same_with_other_numbers_is_told_once_and_says_so() -> None:
    texts = (f"/imu: {n} samples not finite, last value held" for n in (3, 12, 500))
    (line,) = lines(*(note(text) for text in texts))
    assert line == "/imu: 3 samples not finite, last value held (3 times, other numbers)"


def test_a_digit_in_a_name_is_no_number() -> None:
    assert lines(note("G1 is deaf"), note("G2 is deaf")) == ["G1 is deaf", "G2 is deaf"]
    assert lines(note("/imu/1: no"), note("/imu/2: no")) == ["/imu/1: no", "/imu/2: no"]


def test_stages_that_say_the_same_are_named() -> None:
    (line,) = lines(note("no places", source="one"), note("no places", source="other"))
    assert line == "no places (2 times, by one, other)"
