"""What is secret in a URL opens it, and is in nothing that is made of it."""

from __future__ import annotations

import hashlib
import pickle
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundtrace_codecs.errors import CodecError
from groundtrace_codecs.location import Location, is_url, public_argument, without_secrets

URL = "https://someone:pass%40word@host.example:8443/data/walk.mcap?token=abc&x=1#part"
PUBLIC = "https://host.example:8443/data/walk.mcap"


def test_a_location_is_what_is_public_of_a_url_and_knows_what_opens_it() -> None:
    location = Location(URL)
    assert location == PUBLIC
    assert repr(location) == repr(PUBLIC)
    assert Path(location).name == "walk.mcap"
    assert location.opened_by() == URL


def test_a_path_made_of_it_still_opens() -> None:
    Location(URL)
    assert Location(Path(PUBLIC)).opened_by() == URL


def test_paths_are_left_alone() -> None:
    assert Location("folder/a?b.mcap") == "folder/a?b.mcap"
    assert Location(Path("a@b.mcap")).opened_by() == "a@b.mcap"
    assert not is_url("C:/walk.mcap")


@pytest.mark.parametrize("before", ["", "--recording=", "steps.score=", "dask:", "./", "--"])
def test_of_a_url_in_an_argument_the_public_part_stays(before: str) -> None:
    assert public_argument(f"{before}{URL}") == f"{before}{PUBLIC}"
    assert Location(PUBLIC).opened_by() == URL


def test_what_somebody_writes_with_a_url_in_it_stays() -> None:
    assert public_argument("see https://host.example/page?id=5") == (
        "see https://host.example/page?id=5"
    )


def test_another_process_opens_it_too() -> None:
    code = (
        "import pickle, sys; found = pickle.load(sys.stdin.buffer); print(found, found.opened_by())"
    )
    sent = pickle.dumps(Location(URL))
    told = subprocess.run([sys.executable, "-c", code], input=sent, stdout=-1, check=True)
    assert told.stdout.decode().split() == [PUBLIC, URL]


def test_two_that_differ_in_secrets_alone_are_refused() -> None:
    Location("https://host.example/twice.mcap?id=1")
    with pytest.raises(CodecError, match=r"twice.mcap: expected URLs that differ before"):
        Location("https://host.example/twice.mcap?id=2")


def test_what_others_say_of_an_error_loses_the_secrets() -> None:
    Location(URL)
    assert without_secrets(f"403 at {URL} again") == f"403 at {PUBLIC} again"
    assert without_secrets("no such user someone:pass%40word") == "no such user ..."
    Location("ftp://other:word@host/walk.mcap")  # a part of the one before
    assert without_secrets("no such user someone:pass%40word") == "no such user ..."
    assert "abc" not in without_secrets("GET /data/walk.mcap?token=abc&x=1 failed")


WORD = st.text("abcdefghijklmnopqrstuvwxyz0123456789%.-", min_size=12, max_size=20)


@given(WORD, WORD, WORD)
def test_no_part_that_is_secret_is_printed(user: str, password: str, query: str) -> None:
    name = hashlib.sha256(repr((user, password, query)).encode()).hexdigest()
    location = Location(f"ftp://{user}:{password}@host/{name}.mcap?{query}")
    for shown in (str(location), repr(location), f"{location}", str(Path(location))):
        rest = shown.replace(name, "")
        assert not [secret for secret in (user, password, query) if secret in rest]
