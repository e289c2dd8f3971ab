"""Every flag that a slice or a fit can carry: its word, the stage that raises it, and what it means."""

from __future__ import annotations

from enum import StrEnum
from typing import Literal

Stage = Literal["measure", "fit"]


class Flag(StrEnum):
    """What to look at before a number is used; a flag never changes one. docs/flags.md is made from it."""

    raised_by: tuple[Stage, ...]
    meaning: str

    def __new__(cls, word: str, raised_by: Stage | tuple[Stage, ...], meaning: str) -> Flag:
        flag = str.__new__(cls, word)
        flag._value_ = word
        flag.raised_by = (raised_by,) if isinstance(raised_by, str) else raised_by
        flag.meaning = meaning
        return flag

    ALBEDO_ONE = ("albedo_one", "fit", "R is 1 within its error: σa is an upper bound.")
    ANISOTROPIC = (
        "anisotropic",
        "measure",
        "The sample's isophotes are ellipses, the tile's are not: fibres guide the light, or its frames are turned.",
    )
    ASPECT_OFF = (
        "aspect_off",
        "measure",
        "The isophotes are ellipses that the view angle does not explain: scale, beam or camera's roll?",
    )
    BACK_DECIDES = (
        "back_decides",
        "fit",
        "More than half of σa's variance is what is not known of the sample's depth and back.",
    )
    BACKING_ASSUMED = (
        "backing_assumed",
        "fit",
        "The reflectance of the back was not measured: black was taken as 0.03 ± 0.03, a number as ± 0.05.",
    )
    BACKING_UNKNOWN = (
        "backing_unknown",
        "fit",
        'The back is neither "black" nor "air" nor a number: nothing was allowed for.',
    )
    BEYOND_WALL = ("beyond_wall", "fit", "Radii beyond the dish's wall were left out.")
    BLACK_CLIPPED = (
        "black_clipped",
        "measure",
        "The camera cuts off at black: noise below it is lost, and faint light comes out too bright.",
    )
    BLACK_OFFSET = (
        "black_offset",
        "measure",
        "Black in the frames is not that of their darks: what was found was taken off.",
    )
    COARSE_STEPS = (
        "coarse_steps",
        "measure",
        "The data's steps are coarser than noise: light below half a step is lost; errors allow for it.",
    )
    DARK_TEMPERATURE = (
        "dark_temperature",
        "measure",
        "Darks were taken warmer or colder than their frames: take them at one temperature.",
    )
    DIPOLE_UNCHECKED = (
        "dipole_unchecked",
        "fit",
        "No Monte Carlo table of this η and g was at hand: the dipole's model error is that of the nearest.",
    )
    DRIFT = (
        "drift",
        "measure",
        "Light changed between frames by more than noise and labels explain: lamp or camera drifted.",
    )
    DUPLICATE_FRAME = ("duplicate_frame", "measure", "Some frames are copies of others: they were merged once.")
    ETA_SUSPECT = (
        "eta_suspect",
        "fit",
        "The curve fits another η at less than half the χ², with other coefficients: rejected.",
    )
    EXPOSURE_LABELS_OFF = (
        "exposure_labels_off",
        "measure",
        "Exposure times found from the bracket differ from their labels: those found were used.",
    )
    EXPOSURE_RATIOS_DISAGREE = (
        "exposure_ratios_disagree",
        "measure",
        "Frames contradict each other beyond noise: errors were enlarged by it.",
    )
    FEW_RADII = ("few_radii", "fit", "Fewer than 5 radii lie in the window: nothing was fitted.")
    FINITE_SAMPLE = (
        "finite_sample",
        "fit",
        "For information: depth, back and walls of the sample were allowed for.",
    )
    G_ASSUMED = (
        "g_assumed",
        "fit",
        "The slice does not say g: 0 was taken. R and σa depend on it (see sensitivity).",
    )
    G_CLAMPED = (
        "g_clamped",
        "fit",
        "g lies beyond the tables' 0.95: that of 0.95 was taken, which costs 0.2 % at g 0.97.",
    )
    G_FITTED = ("g_fitted", "fit", "g was fitted to the curve as well.")
    G_SUSPECT = (
        "g_suspect",
        "fit",
        "The curve fits another g at less than half the χ², with other coefficients: rejected.",
    )
    GAIN_UNKNOWN = (
        "gain_unknown",
        "measure",
        "The camera's gain could not be found from the frames: errors of single pixels are rough.",
    )
    GEOMETRY_UNCHECKED = (
        "geometry_unchecked",
        "measure",
        "The picture could not be compared with view angle and axis: see docs/measuring.md.",
    )
    GLARE = (
        "glare",
        "measure",
        "An even floor lies under the sample's light, as veiling glare makes it: --glare subtracts it.",
    )
    GLINT = (
        "glint",
        "measure",
        "Some pixels off the spot are saturated in every exposure, as by a glint: they and those around were left out.",
    )
    SIDE_UNKNOWN = (
        "side_unknown",
        "fit",
        "Beam and camera are tilted: R and light near the beam hang on the camera's side; errors allow for either.",
    )
    INCIDENCE_OBLIQUE = (
        "incidence_oblique",
        "fit",
        "The beam falls in at 10° or more from the normal, and the dipole takes it as normal.",
    )
    JOINT = ("joint", "fit", "Several slices were fitted together; the flags of each stand here too.")
    LEAK = ("leak", "measure", "Pixels beside saturated ones come out too bright: what was found was taken off.")
    LIGHT_LOST = (
        "light_lost",
        ("measure", "fit"),
        "Over 2 % of the light (in a fit 5 %) fell outside the frame: its share was estimated, and R rests on it.",
    )
    MISSING_PIXELS = (
        "missing_pixels",
        "measure",
        "Some pixels hold no number in any frame: they were left out, and counted in provenance.",
    )
    MOVED = ("moved", "measure", "The picture moved between exposures.")
    NARROW_SAMPLE = (
        "narrow_sample",
        "fit",
        "The dish's wall is nearer than 12 mean free paths; or than 3/σtr and not allowed for: σa is too high then.",
    )
    NARROW_BAND = (
        "narrow_band",
        "measure",
        "Green is darker than red and blue let expect: blood or a dye? There the colour matrix may be worse than none.",
    )
    NARROW_SPOT = (
        "narrow_spot",
        "measure",
        "The spot falls between the pixels of red or blue: its share of the error of R was added.",
    )
    NEGATIVE_LIGHT = (
        "negative_light",
        "measure",
        "The colour matrix makes light of some radii negative beyond noise: the colour there lies outside the space.",
    )
    NOISE = ("noise", "fit", "The curve does not determine σs′ to within a factor: nothing was identified.")
    NONLINEAR = (
        "nonlinear",
        "measure",
        "The camera's response bends: it was straightened by what the bracket shows.",
    )
    NOT_CONVERGED = (
        "not_converged",
        "fit",
        "The optimiser did not converge; or the dipole was asked for where no table is near enough to tell its error.",
    )
    NOT_LINEAR = (
        "not_linear",
        "measure",
        "The frames are not linear (JPEG, video): their response curve was fitted, good to percents at best.",
    )
    POLARISED = (
        "polarised",
        "measure",
        "The beam is polarised and oblique: what enters depends on a direction that is not known; errors allow for it.",
    )
    POOR_FIT = (
        "poor_fit",
        "fit",
        "χ²: the curve departs from the model by more than its errors allow, and the intervals grew by "
        "as much. Wrong g, window, broad band or glare?",
    )
    POOR_FIT_RUNS = (
        "poor_fit_runs",
        "fit",
        "Runs test: long runs of residuals of one sign. Errors are overstated, or the curve's shape is "
        "off by less than they say.",
    )
    REFLECTANCE_SD_ASSUMED = (
        "reflectance_sd_assumed",
        "measure",
        "session.toml does not state reflectance_sd: 1 % of the reflectance was assumed.",
    )
    ROBUST = ("robust", "fit", "Fitted by Huber's loss: radii far off count less.")
    ROBUST_ADVISED = (
        "robust_advised",
        "fit",
        "A few radii lie far from their neighbours: dust or glare? --robust leaves them out.",
    )
    ROUGH_FINISH = ("rough_finish", "measure", "A rough surface adds up to 0.04 to R.")
    SATURATED = ("saturated", "measure", "Pixels are saturated even in the shortest exposure: they were left out.")
    SCALE_FREE = ("scale_free", "fit", "Fitted with an unknown factor on the curve.")
    SCALE_SD_ASSUMED = (
        "scale_sd_assumed",
        "measure",
        "session.toml does not state mm_per_px_rel_sd: 0.5 % was assumed.",
    )
    SCALE_SD_UNKNOWN = (
        "scale_sd_unknown",
        "fit",
        "The slice does not state scale_rel_sd: an error common to curve and R counts as 0.",
    )
    SCALE_SUSPECT = (
        "scale_suspect",
        "fit",
        "The light under the curve is far from R: are the radii in mm and the values in 1/mm²?",
    )
    SD_FILLED = ("sd_filled", "fit", "Some radii came without errors: they were taken from their neighbours'.")
    SD_UNKNOWN = (
        "sd_unknown",
        "fit",
        "The curve came without errors: they were taken as equal relative ones, from its own scatter.",
    )
    SECOND_SPOT = ("second_spot", "measure", "There is a second bright spot in the picture.")
    SHAPE_MISFIT = (
        "shape_misfit",
        "fit",
        "Over a fifth of the window the curve lies more than 15 % off the model: rejected.",
    )
    SIGMA_A_UNIDENTIFIABLE = (
        "sigma_a_unidentifiable",
        "fit",
        "The data give σa no upper end, or do not tell it from a thin sample's depth and back: σs′ holds, σa is not "
        "stated.",
    )
    SINGLE_SCATTERING = (
        "single_scattering",
        "fit",
        "Single scattering dominates (α′ < 0.5): the dipole does not hold.",
    )
    SLICE_RADIAL_DISAGREE = (
        "slice_radial_disagree",
        "measure",
        "The slice and the average over all directions differ by more than their errors.",
    )
    SPECKLE = ("speckle", "measure", "A laser makes speckle: the error of the total is larger than the noise says.")
    SPOT_DIFFERS = (
        "spot_differs",
        "measure",
        "The spot on the tile is not as wide as session.toml states: out of focus, or another beam?",
    )
    SPOT_SUSPECT = (
        "spot_suspect",
        "fit",
        "No spot is stated, and the curve fits one at less than half the χ², with other coefficients: rejected.",
    )
    SPOT_WIDE = (
        "spot_wide",
        "fit",
        "The spot is wider than a mean free path: the curve near it is mostly the spot's own.",
    )
    THICKNESS_ASSUMED = (
        "thickness_assumed",
        "fit",
        "The slice does not state thickness_sd_mm: 2 % was taken.",
    )
    THIN_SAMPLE = (
        "thin_sample",
        "fit",
        "The sample is so thin (τ′ below 8 on black, else 4) that the model itself may be off; or thinner than 3/σtr "
        "and not allowed for: σa is too high then.",
    )
    TOTAL_AT_LIMIT = ("total_at_limit", "fit", "R lies beyond what the model can reach.")
    TOTAL_INCONSISTENT = (
        "total_inconsistent",
        "fit",
        "R and the curve contradict each other by more than 4 of their sd: rejected.",
    )
    TOTAL_UNKNOWN = ("total_unknown", "fit", "R was not measured: the fit is free and badly conditioned.")
    TWO_MEDIA = ("two_media", "fit", "Another medium fits as well: the intervals hold both.")
    UNDER_GLASS = (
        "under_glass",
        "fit",
        "A glass cover sends light back in and out: the fit takes the surface as bare, and the curve is off by "
        "15 to 65 %.",
    )
    UNNAMED = (
        "unnamed",
        "measure",
        "The material is still unnamed, as in the template: are the other values yours, or its examples?",
    )
    VIEW_ANGLE_OFF = (
        "view_angle_off",
        "measure",
        "The isophotes of sample and tile ask for another view angle, which provenance names.",
    )
    VIEW_ANGLE_SD_ASSUMED = (
        "view_angle_sd_assumed",
        "measure",
        "session.toml does not state view_angle_sd_deg: 1 degree was assumed.",
    )
    WHITE_BELOW_STATED = (
        "white_below_stated",
        "measure",
        "Values pile up below the stated white: they were taken as saturated from there on.",
    )
    WHITE_UNSEEN = (
        "white_unseen",
        "measure",
        "No frame reaches saturation: the white that is stated was used, and none where none is.",
    )
    WINDOW_SHORT = ("window_short", "fit", "The curve ends before 1/σtr: σa rests on R alone.")


def meaning_of(word: str) -> str:
    """What a flag means; one that this version does not know says so."""
    return next((flag.meaning for flag in Flag if flag == word), "not a flag of this version")
