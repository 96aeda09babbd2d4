"""Signal processing: filters, resampling, noise, spectra, periodicity, assignment."""
