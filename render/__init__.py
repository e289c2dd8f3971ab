"""The BSSRDF in Mitsuba 3: integrators, scenes and the comparison with full Monte Carlo. Needs `bssrdf[render]`."""

from typing import TYPE_CHECKING

from bssrdf.door import door

if TYPE_CHECKING:
    from bssrdf.render.choose import RULE as RULE
    from bssrdf.render.choose import choose_model as choose_model
    from bssrdf.render.choose import mc_refusal as mc_refusal
    from bssrdf.render.choose import mc_remarks as mc_remarks
    from bssrdf.render.choose import remarks as remarks
    from bssrdf.render.choose import spread_mm as spread_mm
    from bssrdf.render.compare import compare_models as compare_models
    from bssrdf.render.compare import scores_text as scores_text
    from bssrdf.render.compare import write_comparison as write_comparison
    from bssrdf.render.draw import QUALITIES as QUALITIES
    from bssrdf.render.draw import Goal as Goal
    from bssrdf.render.draw import Quality as Quality
    from bssrdf.render.draw import body_mask as body_mask
    from bssrdf.render.draw import render as render
    from bssrdf.render.material import HALF_ALBEDO as HALF_ALBEDO
    from bssrdf.render.material import RenderMaterial as RenderMaterial
    from bssrdf.render.material import find_medium as find_medium
    from bssrdf.render.mesh_file import read_mesh as read_mesh
    from bssrdf.render.picture import EPSILON as EPSILON
    from bssrdf.render.picture import WHITE_PERCENTILE as WHITE_PERCENTILE
    from bssrdf.render.picture import Picture as Picture
    from bssrdf.render.picture import Pixels as Pixels
    from bssrdf.render.picture import Stage as Stage
    from bssrdf.render.picture import exposure as exposure
    from bssrdf.render.picture import load_stage as load_stage
    from bssrdf.render.picture import render_pass as render_pass
    from bssrdf.render.picture import shown as shown
    from bssrdf.render.picture import write_pictures as write_pictures
    from bssrdf.render.plugins import TERMS as TERMS
    from bssrdf.render.plugins import Model as Model
    from bssrdf.render.plugins import RenderOptions as RenderOptions
    from bssrdf.render.variant import ADVICE as ADVICE
    from bssrdf.render.variant import MISSING as MISSING
    from bssrdf.render.variant import find_backend as find_backend
else:
    __getattr__, __dir__, __all__ = door(__name__, __file__)
