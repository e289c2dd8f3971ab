"""The BSSRDF in Mitsuba 3: integrators, scenes and the comparison with full Monte Carlo. Needs `bssrdf[render]`."""
