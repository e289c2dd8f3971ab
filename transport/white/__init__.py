"""Tables of Monte Carlo light: walks without absorption, smoothed, put together, kept in files, looked up."""
