"""Inertial navigation of a foot: strapdown integration held by the moments the foot stands still.

:class:`~groundtrace.inertial.navigator.FootNavigator` takes the samples of one sensor on a foot and
gives places; it is a stage of pipelines.
"""
