"""Many inputs: the steps on files, the bulk format, stages that resume, a cluster."""

from typing import TYPE_CHECKING

from bssrdf.door import door

if TYPE_CHECKING:
    from bssrdf.batch.arrow import is_parquet as is_parquet
    from bssrdf.batch.arrow import kind_of_file as kind_of_file
    from bssrdf.batch.child import THREADS as THREADS
    from bssrdf.batch.cluster import connected as connected
    from bssrdf.batch.convert import from_parquet as from_parquet
    from bssrdf.batch.convert import to_parquet as to_parquet
    from bssrdf.batch.fit_bulk import fit_parquet as fit_parquet
    from bssrdf.batch.fit_steps import fit_files as fit_files
    from bssrdf.batch.fit_steps import fit_joint_files as fit_joint_files
    from bssrdf.batch.fit_steps import read_fits as read_fits
    from bssrdf.batch.fit_steps import slice_file as slice_file
    from bssrdf.batch.fit_steps import stale as stale
    from bssrdf.batch.fit_steps import validate_fit as validate_fit
    from bssrdf.batch.fits_parquet import read_fits_of as read_fits_of
    from bssrdf.batch.inputs import STAGES as STAGES
    from bssrdf.batch.run import MEASURED as MEASURED
    from bssrdf.batch.run import run_batch as run_batch
    from bssrdf.batch.slices_parquet import Named as Named
    from bssrdf.batch.slices_parquet import read_slices as read_slices
    from bssrdf.batch.slices_parquet import write_slices as write_slices
    from bssrdf.batch.stages import StageOptions as StageOptions
    from bssrdf.batch.tables import sample_on as sample_on
else:
    __getattr__, __dir__, __all__ = door(__name__, __file__)
