"""Orientation, compass and heading of a worn sensor: gyroscope, gravity and magnetic field fused.

:class:`~groundtrace.heading.estimator.HeadingEstimator` takes samples and gives orientation,
heading, gyroscope bias and the verdicts on the magnetic field; it knows nothing of pipelines.
"""
