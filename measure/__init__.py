"""From a session's frames to merged images, and from these to the slice and the total reflectance."""

from typing import TYPE_CHECKING

from bssrdf.door import door

if TYPE_CHECKING:
    from bssrdf.measure.bracket import bracket_of as bracket_of
    from bssrdf.measure.calibrate import calibrate_camera as calibrate_camera
    from bssrdf.measure.calibrate import radius_of_edge as radius_of_edge
    from bssrdf.measure.calibrate import radius_on_target as radius_on_target
    from bssrdf.measure.hdr import DarkPaired as DarkPaired
    from bssrdf.measure.hdr import Hdr as Hdr
    from bssrdf.measure.hdr import Planes as Planes
    from bssrdf.measure.hdr import Progress as Progress
    from bssrdf.measure.hdr import Shot as Shot
    from bssrdf.measure.hdr import merge as merge
    from bssrdf.measure.hdr import read_ahead as read_ahead
    from bssrdf.measure.image import Image as Image
    from bssrdf.measure.levels import corrections_of as corrections_of
    from bssrdf.measure.levels import straight as straight
    from bssrdf.measure.merged import Merged as Merged
    from bssrdf.measure.merged import StaleImages as StaleImages
    from bssrdf.measure.merged import read_merged as read_merged
    from bssrdf.measure.pixels import grids_of as grids_of
    from bssrdf.measure.scene import Marks as Marks
    from bssrdf.measure.scene import light_of as light_of
    from bssrdf.measure.scene import marks_of as marks_of
    from bssrdf.measure.scene import picture as picture
    from bssrdf.measure.scene import saturation_map as saturation_map
    from bssrdf.measure.session import Measured as Measured
    from bssrdf.measure.session import images_of as images_of
    from bssrdf.measure.session import measure_session as measure_session
    from bssrdf.measure.slice import SliceOptions as SliceOptions
    from bssrdf.measure.slice import measure_slice as measure_slice
else:
    __getattr__, __dir__, __all__ = door(__name__, __file__)
