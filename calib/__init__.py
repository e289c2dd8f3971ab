"""What calibrates a picture: counts to light, pixels to mm, colours."""

from typing import TYPE_CHECKING

from bssrdf.door import door

if TYPE_CHECKING:
    from bssrdf.calib.beam_radius import knife_edge_radius as knife_edge_radius
    from bssrdf.calib.beam_radius import radius_on_tile as radius_on_tile
    from bssrdf.calib.colour import calibrate_colour as calibrate_colour
    from bssrdf.calib.colour import may_have_narrow_band as may_have_narrow_band
    from bssrdf.calib.colour import slice_matrix as slice_matrix
    from bssrdf.calib.counts import pile_up_dn as pile_up_dn
    from bssrdf.calib.counts import plateau_dn as plateau_dn
    from bssrdf.calib.counts import step_dn as step_dn
    from bssrdf.calib.exposures import Comparison as Comparison
    from bssrdf.calib.exposures import InCommon as InCommon
    from bssrdf.calib.exposures import LocalRatios as LocalRatios
    from bssrdf.calib.exposures import comparable as comparable
    from bssrdf.calib.exposures import compared as compared
    from bssrdf.calib.exposures import least_signal as least_signal
    from bssrdf.calib.exposures import local_log_ratios as local_log_ratios
    from bssrdf.calib.exposures import rough_log_ratio as rough_log_ratio
    from bssrdf.calib.exposures import shared_noise as shared_noise
    from bssrdf.calib.exposures import signal_weight as signal_weight
    from bssrdf.calib.few_parameters import least_squares as least_squares
    from bssrdf.calib.frame_model import Exposures as Exposures
    from bssrdf.calib.frame_model import FrameModel as FrameModel
    from bssrdf.calib.frame_model import leak_of as leak_of
    from bssrdf.calib.frame_model import solve_frames as solve_frames
    from bssrdf.calib.frame_solution import Exposed as Exposed
    from bssrdf.calib.geometry import calibrate_geometry as calibrate_geometry
    from bssrdf.calib.monotone import Monotone as Monotone
    from bssrdf.calib.photon_transfer import Gain as Gain
    from bssrdf.calib.photon_transfer import clipped_variance as clipped_variance
    from bssrdf.calib.photon_transfer import pair_gain as pair_gain
    from bssrdf.calib.photon_transfer import read_noise_dn as read_noise_dn
    from bssrdf.calib.photon_transfer import thinned as thinned
    from bssrdf.calib.registration import shift_between as shift_between
    from bssrdf.calib.response import Response as Response
    from bssrdf.calib.response import fit_response as fit_response
    from bssrdf.calib.sensor import BEND_PIVOT as BEND_PIVOT
    from bssrdf.calib.sensor import Sensor as Sensor
    from bssrdf.calib.sensor import by_row as by_row
    from bssrdf.calib.sensor import master_dark as master_dark
    from bssrdf.calib.sensor import rows_of as rows_of
    from bssrdf.calib.spot import Spot as Spot
    from bssrdf.calib.spot import find_spot as find_spot
    from bssrdf.calib.surface import Surface as Surface
    from bssrdf.calib.target import Target as Target
else:
    __getattr__, __dir__, __all__ = door(__name__, __file__)
