"""One place of several localizers: no surer than each, whatever their errors have in common."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundtrace.localizers.intersection import CovarianceIntersection, intersected
from groundtrace.pipeline.parameters import StageConfig
from groundtrace.pipeline.stage import StageRunner
from groundtrace_codecs.events import CandidateBlock, Fix, StageSpec, StepEvent

if TYPE_CHECKING:
    from groundtrace_codecs.events import Event

#: Along x one localizer is sure to 0.1 m, the other to 1 m; along y the other way round.
ALONG, ACROSS = (0.01, 0.0, 1.0), (1.0, 0.0, 0.01)
SPECS = [
    StageSpec(name, "any", topic, ("all",), (), (), (), given)
    for topic in ("/s", "/t")
    for name, given in (("one", "fix"), ("two", "fix"), ("steps", "step"))
]


def fix(
    name: str,
    x: float,
    y: float,
    spread: tuple[float, float, float],
    time_ns: int = 5,
    *,
    doubted: bool = False,
) -> Fix:
    return Fix(time_ns, x, y, spread, 1e-4, name, 4, name, doubted)


def step(time_ns: int, topic: str = "/s") -> StepEvent:
    return StepEvent(time_ns, "impact", "", topic, "steps", 1.0)


def fixes_of(*items: Fix | StepEvent) -> list[Fix]:
    kind = CovarianceIntersection
    sources = dict(zip(kind.takes, (("one", "two"), ("steps",)), strict=True))
    config = StageConfig("covariance-intersection", "place")
    runner = StageRunner(config, kind, kind.Parameters(), sources, None)
    told: list[Event] = [e for item in (*SPECS, *items) for e in runner.process(item)]
    return [e for e in (*told, *runner.flush()) if isinstance(e, Fix)]


def test_each_tells_the_direction_that_it_is_sure_of() -> None:
    found = intersected([fix("one", 1.0, 1.0, ALONG), fix("two", 2.0, 2.0, ACROSS)])
    # by the equation: information (100 + 1) / 2 along each axis, places weighed 100 to 1
    assert (found.x, found.y) == pytest.approx(((100 + 2) / 101, (1 + 200) / 101))
    np.testing.assert_allclose(found.covariance, np.eye(2) * 2 / 101)
    assert found.residual == pytest.approx(np.sqrt(2 / 1.01))


def test_two_that_tell_the_same_are_no_surer_than_one() -> None:
    found = intersected([fix("one", 1.0, 2.0, ALONG), fix("two", 1.0, 2.0, ALONG)])
    np.testing.assert_allclose(found.covariance, np.diag([0.01, 1.0]))
    assert (found.x, found.y, found.residual) == pytest.approx((1.0, 2.0, 0.0))


@pytest.mark.parametrize(("own", "spread"), [(0.0, 1.0), (0.5, 2 / 3), (1.0, 0.5)])
def test_what_each_has_of_its_own_makes_the_place_surer_and_leaves_it_where_it_is(
    own: float, spread: float
) -> None:
    two = [fix("one", 1.0, 1.0, ALONG), fix("two", 2.0, 2.0, ACROSS)]
    found, shared = intersected(two, own), intersected(two)
    assert (found.x, found.y) == (shared.x, shared.y)
    np.testing.assert_allclose(found.covariance, spread * shared.covariance)
    one = intersected(two[:1], own)
    np.testing.assert_allclose(one.covariance, np.diag([ALONG[0], ALONG[2]]))


def test_errors_that_share_nothing_are_claimed_as_they_are() -> None:
    rng = np.random.default_rng(3)
    places = rng.normal(
        scale=np.sqrt([[ALONG[0], ALONG[2]], [ACROSS[0], ACROSS[2]]]), size=(400, 2, 2)
    )
    told = [(ALONG, ACROSS)[i] for i in range(2)]
    found = [
        intersected(
            [
                fix(str(i), *place, spread)
                for i, (place, spread) in enumerate(zip(those, told, strict=True))
            ],
            1.0,
        )
        for those in places
    ]
    off = np.array([(one.x, one.y) for one in found])
    np.testing.assert_allclose(
        off.T @ off / len(off), found[0].covariance, atol=0.15 * found[0].covariance[0, 0]
    )


@given(st.integers(0, 2**32 - 1))
def test_it_never_claims_more_than_is_known_of_errors_that_are_alike(seed: int) -> None:
    rng = np.random.default_rng(seed)
    # errors e_1, e_2 with any joint covariance; what each claims is its own part of that
    root = rng.normal(size=(4, 4))
    joint = root @ root.T + 1e-3 * np.eye(4)
    parts = [joint[:2, :2], joint[2:, 2:]]
    told = [(float(p[0, 0]), float(p[0, 1]), float(p[1, 1])) for p in parts]
    claimed = intersected([fix("one", 0, 0, told[0]), fix("two", 0, 0, told[1])]).covariance
    gains = np.hstack([claimed @ np.linalg.inv(p) / 2 for p in parts])
    real = gains @ joint @ gains.T
    assert np.linalg.eigvalsh(claimed - real)[0] >= -1e-9 * np.trace(claimed)


def test_a_step_has_one_place_when_it_is_announced() -> None:
    one, two = fix("one", 1.0, 1.0, ALONG), fix("two", 2.0, 2.0, ACROSS)
    (found,) = fixes_of(one, two, step(5))
    assert (found.time_ns, found.stage, found.method) == (5, "place", "covariance-intersection")
    assert (found.x_m, found.picks) == (pytest.approx(102 / 101), 4)


def test_steps_of_two_streams_have_their_places() -> None:
    one, two = fix("one", 1.0, 1.0, ALONG), fix("one", 2.0, 2.0, ALONG, 9)
    found = fixes_of(one, step(5), two, step(9, "/t"))
    assert [(f.time_ns, f.x_m) for f in found] == [(5, 1.0), (9, 2.0)]


def test_a_localizer_that_doubts_its_waves_does_not_count() -> None:
    one, two = fix("one", 1.0, 1.0, ALONG, doubted=True), fix("two", 2.0, 2.0, ACROSS)
    (found,) = fixes_of(one, two, step(5))
    assert (found.x_m, found.covariance) == (2.0, pytest.approx(ACROSS))


def test_fixes_of_another_step_do_not_count() -> None:
    assert fixes_of(fix("one", 1.0, 1.0, ALONG, 4), step(5)) == []


def test_a_fix_that_claims_nothing_is_left_out_and_alone_makes_no_place() -> None:
    unknown = fix("one", 1.0, 1.0, (float("nan"),) * 3)
    assert intersected([unknown, fix("two", 2.0, 2.0, ACROSS)]).x == 2.0
    assert not intersected([unknown]).located
    assert fixes_of(unknown, step(5)) == []


def test_a_step_without_a_place_is_a_rejected_candidate() -> None:
    kind = CovarianceIntersection
    sources = dict(zip(kind.takes, (("one", "two"), ("steps",)), strict=True))
    config = StageConfig("covariance-intersection", "place")
    runner = StageRunner(config, kind, kind.Parameters(), sources, None)
    told = [e for item in (*SPECS, step(5)) for e in runner.process(item)]
    (block,) = [e for e in told if isinstance(e, CandidateBlock)]
    assert not block.accepted[0]
