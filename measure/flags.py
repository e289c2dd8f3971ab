"""Every flag a measurement can raise, with what it means; docs/flags.md lists them for the reader."""

from __future__ import annotations

MEANING = {
    "black_clipped": "The camera cuts off at black: noise below it is lost, and faint light comes out too bright.",
    "black_offset": "Black in the frames is not that of their darks: what was found was taken off.",
    "dark_temperature": "Darks were taken warmer or colder than their frames: take them at one temperature.",
    "drift": "Light changed between frames by more than noise and labels explain: lamp or camera drifted.",
    "duplicate_frame": "Some frames are copies of others: they were merged once.",
    "exposure_labels_off": "Exposure times found from the bracket differ from their labels: those found were used.",
    "exposure_ratios_disagree": "Frames contradict each other beyond noise: errors were enlarged by it.",
    "gain_unknown": "The camera's gain could not be found from the frames: errors of single pixels are rough.",
    "glare": "An even floor lies under the sample's light, as veiling glare makes it: --glare subtracts it.",
    "leak": "Pixels beside saturated ones come out too bright: what was found was taken off.",
    "light_lost": "Much light fell outside the frame: its share was estimated and is uncertain.",
    "moved": "The picture moved between exposures.",
    "nonlinear": "The camera's response bends: it was straightened by what the bracket shows.",
    "not_linear": "The frames are not linear (JPEG, video): their response curve was fitted, good to percents at best.",
    "reflectance_sd_assumed": "session.toml does not state reflectance_sd: 1 % of the reflectance was assumed.",
    "saturated": "Pixels are saturated even in the shortest exposure: they were left out.",
    "scale_sd_assumed": "session.toml does not state mm_per_px_rel_sd: 0.5 % was assumed.",
    "second_spot": "There is a second bright spot in the picture.",
    "slice_radial_disagree": "The slice and the average over all directions differ by more than their errors.",
    "speckle": "A laser makes speckle: the error of the total is larger than the noise says.",
    "unnamed": "The material is still unnamed, as in the template: are the other values yours, or its examples?",
    "view_angle_sd_assumed": "session.toml does not state view_angle_sd_deg: 1 degree was assumed.",
    "white_below_stated": "Values pile up below the stated white: they were taken as saturated from there on.",
    "white_unseen": "No frame reaches saturation: the white that is stated was used, and none where none is.",
}
