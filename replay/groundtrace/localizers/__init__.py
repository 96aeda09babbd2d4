"""Localizers: places of impacts from arrivals, bearings, wave physics."""
