"""Wave physics of floors and ground: the formulas that detectors and localizers lean on.

::

    solid       P, S and Rayleigh waves of a solid                      thesis, section 1.1 and 1.2
    lamb        Lamb waves A0 of a plate, cut-off frequencies           section 1.3
    response    what a sensor on a thin plate sees, and its envelope    sections 4.1 to 4.3
    perceived   velocities and arrival times read off that              sections 4.2 and 4.3

The thesis is the one on locating people by seismic waves. docs/waves.md says what
to make of it; ``bench/floor_tables.py`` prints its tables.
"""
