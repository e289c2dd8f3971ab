"""Shutter, beam and camera: drivers, capture, and the simulated bench."""

from typing import TYPE_CHECKING

from bssrdf.door import door

if TYPE_CHECKING:
    from bssrdf.rig.capture import Event as Event
    from bssrdf.rig.capture import Report as Report
    from bssrdf.rig.capture import capture_session as capture_session
    from bssrdf.rig.commands import rig_list as rig_list
    from bssrdf.rig.sim.launch import SCALE_REL_SD as SCALE_REL_SD
    from bssrdf.rig.sim.launch import TILE_SD as TILE_SD
    from bssrdf.rig.sim.launch import SimulatedBench as SimulatedBench
    from bssrdf.rig.sim.launch import simulated_bench as simulated_bench
    from bssrdf.rig.sim.light import SeenLight as SeenLight
    from bssrdf.rig.sim.light import seen_light as seen_light
    from bssrdf.rig.sim.media import SampleMedium as SampleMedium
    from bssrdf.rig.sim.media import published_sample as published_sample
    from bssrdf.rig.sim.media import white_tile as white_tile
    from bssrdf.rig.sim.picture import PictureGeometry as PictureGeometry
    from bssrdf.rig.sim.picture import picture as picture
    from bssrdf.rig.sim.raw_files import dng_bytes as dng_bytes
    from bssrdf.rig.sim.scene import BRACKET_S as BRACKET_S
    from bssrdf.rig.sim.scene import BenchScene as BenchScene
    from bssrdf.rig.sim.sensor import SimSensor as SimSensor
    from bssrdf.rig.sim.sensor import expose as expose
    from bssrdf.rig.sim.sensor import mosaic as mosaic
else:
    __getattr__, __dir__, __all__ = door(__name__, __file__)
