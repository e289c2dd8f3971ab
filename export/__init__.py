"""From measured coefficients to what renderers read, looking as measured."""

from typing import TYPE_CHECKING

from bssrdf.door import door

if TYPE_CHECKING:
    from bssrdf.export.closure import Closure as Closure
    from bssrdf.export.material import ExportMaterial as ExportMaterial
    from bssrdf.export.material import find_materials as find_materials
    from bssrdf.export.run import export_files as export_files
    from bssrdf.export.run import read_version as read_version
else:
    __getattr__, __dir__, __all__ = door(__name__, __file__)
