"""Many inputs: the steps on files, the bulk format, stages that resume, a cluster."""

from typing import TYPE_CHECKING

from bssrdf.door import door

if TYPE_CHECKING:
    from bssrdf.batch.fit_steps import fit_files as fit_files
    from bssrdf.batch.fit_steps import fit_joint_files as fit_joint_files
    from bssrdf.batch.fit_steps import read_fits as read_fits
    from bssrdf.batch.fit_steps import slice_file as slice_file
    from bssrdf.batch.fit_steps import stale as stale
    from bssrdf.batch.fit_steps import validate_fit as validate_fit
else:
    __getattr__, __dir__, __all__ = door(__name__, __file__)
