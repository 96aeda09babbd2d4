"""Localizers: locations of impacts from arrivals, bearings, wave physics."""
