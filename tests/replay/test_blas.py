"""Threads of numpy's libraries: one, where nobody said otherwise."""

from __future__ import annotations

import os

import pytest

from groundtrace.cli.main import main
from groundtrace.runtime import THREADS, limit_blas_threads


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
