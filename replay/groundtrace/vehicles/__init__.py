"""Vehicles from seismic power: where they are, how they go, when they pass.

::

    medium       how power falls with distance, and what a geophone does to it  (1) to (4)
    analytic     the analytic signal of blocks
    floors       the noise floor of powers, running
    cycles       power per channel and working cycle                            (6)
    ratios       the ratio of powers of two sensors                             (10) to (15)
    positions    a place from ratios                                            (16), (17)
    likelihood   a place from the powers of one cycle                           (7)
    lines        a straight course through places, crossings of a line          (8), (9)
    scoring      the likelihood of mean powers
    courses      a straight course from the powers of all cycles
    search       where that fit may start
    two_courses  the courses of two vehicles in one run
    tracker      curved paths
    passes       passes by one station, also overlapping ones
    roads        vehicles by their passes at a few stations
    traffic      vehicles by the powers of a few stations jointly: traffic_model, traffic_scatter,
                 traffic_fit, traffic_search
    presence     vehicle or footsteps

The numbers are equations of Yu. V. Morozov, M. A. Raifeld, A. A. Spektor: Processing of seismic
signals for estimating the trajectory of a moving vehicle, Novosibirsk State Technical University,
2018 (in Russian), called the paper in this package. docs/vehicles.md says what was corrected.
"""
