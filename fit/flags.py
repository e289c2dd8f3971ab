"""Every flag a fit can carry, with what it means; docs/flags.md lists them for the reader."""

from __future__ import annotations

MEANING = {
    "albedo_one": "R is 1 within its error: σa is an upper bound.",
    "dipole_unchecked": (
        "No Monte Carlo table of this η and g was at hand: the dipole's model error is that of the nearest."
    ),
    "eta_suspect": "The curve fits another η at less than half the χ², with other coefficients: rejected.",
    "few_radii": "Fewer than 5 radii lie in the window: nothing was fitted.",
    "g_assumed": "The slice does not say g: 0 was taken. R and σa depend on it (see sensitivity).",
    "g_clamped": "g lies beyond the tables' 0.95: that of 0.95 was taken, which costs 0.2 % at g 0.97.",
    "g_fitted": "g was fitted to the curve as well.",
    "g_suspect": "The curve fits another g at less than half the χ², with other coefficients: rejected.",
    "incidence_oblique": ("The beam falls in at 10° or more from the normal, and the dipole takes it as normal."),
    "joint": "Several slices were fitted together; the flags of each stand here too.",
    "light_lost": "Over 5 % of the light fell outside the frame: R rests on an estimate.",
    "narrow_sample": "The sample reaches less than 3/σtr from the beam: light leaves by its sides, σa is too high.",
    "noise": "The curve does not determine σs′ to within a factor: nothing was identified.",
    "not_converged": (
        "The optimiser did not converge; or the dipole was asked for where no table is near enough to tell its error."
    ),
    "poor_fit": (
        "χ²: the curve departs from the model by more than its errors allow, and the intervals grew by "
        "as much. Wrong g, window, broad band or glare?"
    ),
    "poor_fit_runs": (
        "Runs test: long runs of residuals of one sign. Errors are overstated, or the curve's shape is "
        "off by less than they say."
    ),
    "robust": "Fitted by Huber's loss: radii far off count less.",
    "robust_advised": "A few radii lie far from their neighbours: dust or glare? --robust leaves them out.",
    "rough_finish": "A rough surface adds up to 0.04 to R.",
    "scale_free": "Fitted with an unknown factor on the curve.",
    "scale_sd_unknown": "The slice does not state scale_rel_sd: an error common to curve and R counts as 0.",
    "scale_suspect": "The light under the curve is far from R: are the radii in mm and the values in 1/mm²?",
    "sd_filled": "Some radii came without errors: they were taken from their neighbours'.",
    "sd_unknown": "The curve came without errors: they were taken as equal relative ones, from its own scatter.",
    "shape_misfit": "Over a fifth of the window the curve lies more than 15 % off the model: rejected.",
    "sigma_a_unidentifiable": "The data give σa no upper end: σs′ holds, σa is not stated.",
    "single_scattering": "Single scattering dominates (α′ < 0.5): the dipole does not hold.",
    "spot_wide": "The spot is wider than a mean free path: the curve near it is mostly the spot's own.",
    "thin_sample": "The sample is thinner than 3/σtr: light leaves through its back, and σa is too high.",
    "total_at_limit": "R lies beyond what the model can reach.",
    "total_inconsistent": "R and the curve contradict each other by more than 4 of their sd: rejected.",
    "total_unknown": "R was not measured: the fit is free and badly conditioned.",
    "two_media": "Another medium fits as well: the intervals hold both.",
    "under_glass": "A glass cover sends light back in and out: the fit takes the surface as bare.",
    "window_short": "The curve ends before 1/σtr: σa rests on R alone.",
}
