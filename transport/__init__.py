"""Light in a medium and through its surface: Fresnel, dipole, single scattering, Monte Carlo walks and their tables."""

from typing import TYPE_CHECKING

from bssrdf.door import door

if TYPE_CHECKING:
    from bssrdf.transport.convention import camera_factor as camera_factor
    from bssrdf.transport.discrete_ordinates import decay_constant as decay_constant
    from bssrdf.transport.discrete_ordinates import decay_constants as decay_constants
    from bssrdf.transport.discrete_ordinates import half_space as half_space
    from bssrdf.transport.discrete_ordinates import half_spaces as half_spaces
    from bssrdf.transport.engine import MIN_BATCHES as MIN_BATCHES
    from bssrdf.transport.engine import IncidentBeam as IncidentBeam
    from bssrdf.transport.engine import MonteCarloMedium as MonteCarloMedium
    from bssrdf.transport.engine import simulate as simulate
    from bssrdf.transport.exit_azimuth import second_harmonic as second_harmonic
    from bssrdf.transport.forward import DipoleModel as DipoleModel
    from bssrdf.transport.forward import ForwardModel as ForwardModel
    from bssrdf.transport.incidence import NORMAL as NORMAL
    from bssrdf.transport.incidence import Incidence as Incidence
    from bssrdf.transport.inverse_total import absorption_ratio as absorption_ratio
    from bssrdf.transport.light_tables import SILENT as SILENT
    from bssrdf.transport.light_tables import Making as Making
    from bssrdf.transport.light_tables import has_light_table as has_light_table
    from bssrdf.transport.light_tables import light_table as light_table
    from bssrdf.transport.light_tables import shipped_table as shipped_table
    from bssrdf.transport.light_tables import tabulated as tabulated
    from bssrdf.transport.light_tables import usual_light as usual_light
    from bssrdf.transport.materials import CHANNELS as CHANNELS
    from bssrdf.transport.materials import Rgb as Rgb
    from bssrdf.transport.materials import find_material as find_material
    from bssrdf.transport.materials import load_materials as load_materials
    from bssrdf.transport.materials import table_check as table_check
    from bssrdf.transport.materials import table_source as table_source
    from bssrdf.transport.medium_curve import Forward as Forward
    from bssrdf.transport.medium_curve import forward_curve as forward_curve
    from bssrdf.transport.parallel import Progress as Progress
    from bssrdf.transport.parallel import run_all as run_all
    from bssrdf.transport.precision import scoped_x64 as scoped_x64
    from bssrdf.transport.single import first_order_total as first_order_total
    from bssrdf.transport.white.archive import table_set as table_set
    from bssrdf.transport.white.archive import write_tables as write_tables
    from bssrdf.transport.white.grid import R_MAX as R_MAX
    from bssrdf.transport.white.grid import R_ZERO as R_ZERO
    from bssrdf.transport.white.grid import V_MAX as V_MAX
    from bssrdf.transport.white.samples import N_BATCHES as N_BATCHES
    from bssrdf.transport.white.samples import WhiteSamples as WhiteSamples
    from bssrdf.transport.white.samples import batches as batches
    from bssrdf.transport.white.samples import merged as merged
    from bssrdf.transport.white.samples import photons_per_batch as photons_per_batch
    from bssrdf.transport.white.samples import sample as sample
    from bssrdf.transport.white.smooth import fit_tables as fit_tables
    from bssrdf.transport.white.store import Policy as Policy
    from bssrdf.transport.white.store import allowed as allowed
    from bssrdf.transport.white.store import cache_directory as cache_directory
    from bssrdf.transport.white.store import nearest as nearest
    from bssrdf.transport.white.store import place as place
    from bssrdf.transport.white.store import shipped as shipped
    from bssrdf.transport.white.store import table_model as table_model
else:
    __getattr__, __dir__, __all__ = door(__name__, __file__)
