"""The table of views: what of a replay is drawn by what.

A kind of event without a view is a lane and a line of the log, see
:class:`~.decisions.PlainView`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .decisions import (
    DetectorViews,
    LossView,
    MassViews,
    NoteView,
    PickerCurves,
    PickView,
    StepCurves,
    StepView,
)
from .headings import HeadingView
from .places import DisagreementView, FixView, MapTracks, StepDetails
from .shots import ShotViews
from .signals import SignalViews
from .site import SensorMap
from .spectrogram import FineSpectrograms, SpectrogramViews
from .vehicles import CourseView, LikelihoodView, PassView, PresenceLanes, RatioViews
from .walk import AzimuthView, StreetMap, WalkMap
from .waves import StepWaves
from .wrong_decisions import WrongPasses, WrongSteps

if TYPE_CHECKING:
    from .context import View

#: All views, in the order in which they take an item.
_ORDER: tuple[type[View], ...] = (
    SignalViews,
    ShotViews,
    SpectrogramViews,
    SensorMap,
    FixView,  # gives stages their colours
    MapTracks,
    DisagreementView,
    StepDetails,
    PickerCurves,
    FineSpectrograms,
    CourseView,
    LikelihoodView,
    PassView,
    PresenceLanes,
    RatioViews,
    StepCurves,
    MassViews,
    HeadingView,
    AzimuthView,
    WalkMap,
    StreetMap,
    DetectorViews,  # draws what no view before it has taken
    PickView,
    StepView,
    StepWaves,
    WrongSteps,
    WrongPasses,
    LossView,
    NoteView,
)
#: By the kind of event, or of signal: the views that draw it.
VIEWS: dict[type[Any], tuple[type[View], ...]] = {
    kind: tuple(view for view in _ORDER if kind in view.kinds)
    for kind in dict.fromkeys(kind for view in _ORDER for kind in view.kinds)
}
