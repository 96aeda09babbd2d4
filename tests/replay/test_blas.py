"""Threads of numpy's libraries: one, where nobody said otherwise."""

from __future__ import annotations

import os

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from groundtrace.cli.main import main
from groundtrace.pipeline.chain import build_pipeline
from groundtrace.pipeline.config import load_pipeline
from groundtrace.pipeline.engine import ReplayLoop
from groundtrace.runtime import THREADS, limit_blas_threads
from groundtrace_codecs.events import Note


@pytest.fixture
def unset(monkeypatch):
    for name in THREADS:
        monkeypatch.setenv(name, "1")  # so that what is set in a test is undone
        monkeypatch.delenv(name)


@pytest.mark.usefixtures("unset")
def test_the_command_line_asks_for_one_thread(capsys):
    main(["--version"])
    assert capsys.readouterr().out
    assert [os.environ.get(name) for name in THREADS] == ["1"] * len(THREADS)
    assert limit_blas_threads() == []


@pytest.mark.usefixtures("unset")
def test_what_people_say_stays(monkeypatch):
    monkeypatch.setenv(THREADS[1], "4")
    assert limit_blas_threads() == []
    assert THREADS[0] not in os.environ


def blas_threads():
    return {lib["num_threads"] for lib in threadpool_info() if lib["user_api"] == "blas"}


@pytest.mark.usefixtures("unset")
def test_a_replay_from_python_takes_one_thread_of_libraries_and_gives_the_others_back():
    seen = []

    def items():
        seen.append(blas_threads())
        yield Note(0, "a line")

    pipeline = build_pipeline(load_pipeline("room-steps"))
    with threadpool_limits(2, "blas"):
        ReplayLoop(pipeline, []).through(items())
        assert seen == [{1}]
        assert blas_threads() == {2}
