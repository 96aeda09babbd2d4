"""Pedestrian dead reckoning: steps times length along the azimuth they go.

:class:`~groundtrace.reckoning.reckoner.DeadReckoner` takes steps, what a sensor felt meanwhile and
known places, and gives a track; it knows nothing of pipelines.
"""
