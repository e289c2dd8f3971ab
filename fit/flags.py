"""Every flag a fit can carry, with what it means; docs/flags.md lists them for the reader."""

from __future__ import annotations

MEANING = {
    "albedo_one": "R is 1 within its error: σa is an upper bound.",
    "dipole_unchecked": "No Monte Carlo table ships for this η and g: the dipole's model error is not known.",
    "few_radii": "Fewer than 5 radii lie in the window: nothing was fitted.",
    "g_assumed": "The slice does not say g: 0 was taken. R and σa depend on it (see sensitivity).",
    "g_fitted": "g was fitted to the curve as well.",
    "g_suspect": "The curve fits another g much better than the one given.",
    "joint": "Several slices were fitted together; the flags of each stand here too.",
    "light_lost": "Over 5 % of the light fell outside the frame: R rests on an estimate.",
    "narrow_sample": "The sample reaches less than 3/σtr from the beam: light leaves by its sides, σa is too high.",
    "noise": "The curve does not determine σs′ to within a factor: nothing was identified.",
    "not_converged": "The search did not come to rest.",
    "poor_fit": "The curve departs from the model by more than its errors allow: wrong g, window, broad band or glare?",
    "rough_finish": "A rough surface adds up to 0.04 to R.",
    "robust": "Fitted by Huber's loss: radii far off count less.",
    "scale_free": "Fitted with an unknown factor on the curve.",
    "scale_suspect": "The light under the curve is far from R: are the radii in mm and the values in 1/mm²?",
    "sd_unknown": "The curve came without errors: they were taken as equal relative ones, from its own scatter.",
    "single_scattering": "Single scattering dominates (α′ < 0.5): the dipole does not hold.",
    "spot_wide": "The spot is wider than a mean free path: the curve near it is mostly the spot's own.",
    "thin_sample": "The sample is thinner than 3/σtr: light leaves through its back, and σa is too high.",
    "total_at_limit": "R lies beyond what the model can reach.",
    "total_inconsistent": "R and the curve contradict each other.",
    "total_unknown": "R was not measured: the fit is free and badly conditioned.",
    "under_glass": "A glass cover sends light back in and out: the fit takes the surface as bare.",
    "window_short": "The curve ends before 1/σtr: σa rests on R alone.",
}
