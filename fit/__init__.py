"""From slices to coefficients: the fit as a sum of terms, its intervals and its verdict."""

from typing import TYPE_CHECKING

from bssrdf.door import door

if TYPE_CHECKING:
    from bssrdf.fit.batch import Fitted as Fitted
    from bssrdf.fit.batch import fit_group as fit_group
    from bssrdf.fit.batch import searched as searched
    from bssrdf.fit.free_g import fit_g as fit_g
    from bssrdf.fit.jobs import FitOptions as FitOptions
    from bssrdf.fit.jobs import Job as Job
    from bssrdf.fit.layout import Curves as Curves
    from bssrdf.fit.layout import curves_of as curves_of
    from bssrdf.fit.layout import sight_of as sight_of
    from bssrdf.fit.models import RULE as RULE
    from bssrdf.fit.models import table_key as table_key
    from bssrdf.fit.problem import Constraint as Constraint
    from bssrdf.fit.run import fit_joint as fit_joint
    from bssrdf.fit.run import fit_slice as fit_slice
    from bssrdf.fit.run import fit_slices as fit_slices
    from bssrdf.fit.solve import Solution as Solution
    from bssrdf.fit.verdict import FEWEST as FEWEST
    from bssrdf.fit.verdict import MAX_LOST as MAX_LOST
    from bssrdf.fit.verdict import MOST_PULL as MOST_PULL
    from bssrdf.fit.verdict import POOR_CHI2 as POOR_CHI2
    from bssrdf.fit.verdict import POOR_RUNS as POOR_RUNS
else:
    __getattr__, __dir__, __all__ = door(__name__, __file__)
