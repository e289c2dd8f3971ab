"""From R_d(r) to σa and σs′, with errors. `run.fit_slices` is the way in; nothing here opens a file."""
