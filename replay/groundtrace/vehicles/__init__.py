"""Vehicles from seismic power: presence, positions, courses, passes.

The numbers are equations of Yu. V. Morozov, M. A. Raifeld, A. A. Spektor: Processing of seismic
signals for estimating the trajectory of a moving vehicle, Novosibirsk State Technical University,
2018 (in Russian), called the paper in this package. docs/vehicles.md says what was corrected.
"""
